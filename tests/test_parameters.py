"""Parameters keep their physical meaning from Python to TOML and back, and a wrong file is refused
in words."""

import dataclasses
import re

import hypothesis.strategies as st
import jax
import numpy as np
import pytest
from hypothesis import given

from maidenflight.errors import InputError
from maidenflight.parameters import (
    COMPONENTS,
    DRONES,
    GEOMETRY,
    QUANTITIES,
    Parameters,
    arm_length,
    check,
    component,
    crazyflie,
    from_toml,
    h_frame,
    name_of,
    noiseless,
    plus_frame,
    read_drone,
    replace,
    sources,
    to_toml,
    write_drone,
    x_frame,
)

GOOD = to_toml(crazyflie(), "crazyflie")
FIELDS = list(QUANTITIES)


@st.composite
def drones(draw):
    def values(quantity):
        low, high = np.float32(quantity.lower), np.float32(quantity.upper)
        number = st.floats(float(low), float(high), width=32)
        return number if quantity.size == 1 else st.tuples(*[number] * quantity.size)

    drawn = {name: draw(values(quantity)) for name, quantity in QUANTITIES.items()}
    side = st.floats(0.01, 0.5)
    frame = h_frame(draw(side), draw(side), reversed_rotors=draw(st.booleans()))
    return Parameters(**drawn | frame)


@given(drones())
def test_toml_reads_back_to_the_same_float32(drone):
    back = from_toml(to_toml(drone, "drawn"))
    for name in FIELDS:
        value = getattr(back, name)
        assert value.dtype == np.float32
        np.testing.assert_array_equal(value, getattr(drone, name), err_msg=name)


def test_a_file_that_says_nothing_of_disturbances_has_none():
    still = GOOD[: GOOD.index("[disturbance]")]
    jax.tree.map(np.testing.assert_array_equal, from_toml(still), crazyflie())


@pytest.mark.parametrize("name", FIELDS)
def test_every_quantity_says_what_it_is(name):
    quantity = QUANTITIES[name]
    for text in (quantity.symbol, quantity.unit, quantity.meaning, quantity.source, quantity.table):
        assert text.strip()
    assert quantity.lower < quantity.upper
    lines = [line for line in GOOD.splitlines() if line.startswith(f"{name} =")]
    assert len(lines) == 1
    comment = lines[0].partition("#")[2]
    assert f"{quantity.symbol} [{quantity.unit}]" in comment
    assert quantity.source in comment


def test_the_crazyflie_has_the_constants_of_the_papers_appendix():
    drone = crazyflie()
    appendix = {
        "gravity": 9.81,
        "mass": 0.028,
        "torque_to_thrust": 5.96e-3,
        "torque_offset": 1.56e-5,
    }
    for name, value in appendix.items():
        assert getattr(drone, name) == np.float32(value), name
    np.testing.assert_array_equal(drone.inertia, np.array([1.33e-5, 1.33e-5, 2.64e-5], np.float32))


def test_the_crazyflie_lacks_what_the_papers_model_lacks():
    drone = crazyflie()
    assert drone.spin_down_ratio == 1
    for name in (
        "motor_coasting",
        "drag",
        "estimator_delay",
        "battery_resistance",
        "battery_discharge",
    ):
        assert not np.any(getattr(drone, name)), name


WHOLE = [name for name, drone in DRONES.items() if not drone.frameless]


@pytest.mark.parametrize("name", WHOLE)
def test_a_named_drone_is_physical_and_reads_by_its_name(name):
    jax.tree.map(np.testing.assert_array_equal, check(read_drone(name)), DRONES[name].make())
    assert name_of(name) == name


@pytest.mark.parametrize("name", DRONES)
def test_every_value_of_a_named_drone_that_is_not_the_papers_has_its_source(name):
    mass = 0.1 if DRONES[name].frameless else None
    drone, said = read_drone(name, mass), sources(name, mass)
    differs = {
        field for field in FIELDS if np.any(getattr(drone, field) != getattr(crazyflie(), field))
    }
    assert differs == set(said)
    for field in said:
        (line,) = (
            line
            for line in to_toml(drone, name, sources=said).splitlines()
            if line.startswith(f"{field} =")
        )
        assert line.endswith(f"({said[field]})")


def test_the_motors_of_named_drones_lift_what_their_firmware_says():
    for name, newtons in (("crazyflie_2.0", 0.48), ("crazyflie_2.1+", 0.48)):
        drone = read_drone(name)
        full = float(drone.thrust_to_weight * drone.mass * drone.gravity)
        assert full == pytest.approx(newtons * 60000 / 65535, rel=1e-5)


@given(st.sampled_from(WHOLE), st.floats(0.5, 1.5))
def test_a_heavier_drone_has_the_same_motors_and_the_mass_where_it_was(name, share):
    drone = read_drone(name)
    heavier = read_drone(name, share * float(drone.mass))
    assert float(heavier.mass) == pytest.approx(share * float(drone.mass), rel=1e-6)
    for product in (
        lambda one: one.thrust_to_weight * one.mass,
        lambda one: one.inertia / one.mass,
    ):
        np.testing.assert_allclose(product(heavier), product(drone), rtol=1e-5)
    others = [field for field in FIELDS if field not in ("mass", "inertia", "thrust_to_weight")]
    for field in others:
        np.testing.assert_array_equal(getattr(heavier, field), getattr(drone, field))


@given(st.floats(0.02, 2.0))
def test_a_frame_of_another_mass_has_the_same_shape_and_density(mass):
    drone, like = read_drone("crazyflie_bolt", mass), read_drone("crazyflie_brushless")
    for pure in (
        lambda one: one.inertia / (one.mass * arm_length(one) ** 2),
        lambda one: one.mass / arm_length(one) ** 3,
        lambda one: one.torque_to_thrust / arm_length(one),
        lambda one: one.ground_effect / arm_length(one) ** 2,
        lambda one: one.thrust_to_weight,
    ):
        np.testing.assert_allclose(pure(drone), pure(like), rtol=1e-4)


def test_a_mass_that_is_missing_or_too_large_is_refused(tmp_path):
    for name, drone in DRONES.items():
        if drone.frameless:
            with pytest.raises(InputError, match=f"{name} .*--mass"):
                read_drone(name)
    with pytest.raises(InputError, match=r"60 g .*crazyflie.*48\.3 g"):
        read_drone("crazyflie", 0.06)
    path = write_drone(tmp_path / "mine.toml", crazyflie())
    assert float(read_drone(path, 0.03).mass) == pytest.approx(0.03)
    with pytest.raises(InputError, match=r"mine\.toml"):
        read_drone(path, 0.06)


def test_a_file_is_named_after_its_drone_and_keeps_further_tables(tmp_path):
    path = write_drone(tmp_path / "mine.toml", crazyflie(), {"record": {"seed": 3}})
    assert 'name = "mine"' in path.read_text()
    assert re.search(r"\[record\]\nseed = 3", path.read_text())
    jax.tree.map(np.testing.assert_array_equal, read_drone(path), crazyflie())


def edited(name, value):
    """The good file with one value written differently; `None` removes the line."""
    text, count = re.subn(rf"(?m)^{name} = .*$", "" if value is None else f"{name} = {value}", GOOD)
    assert count == 1
    return text


WRONG = {
    "broken": (GOOD + "[", "not valid TOML"),
    "empty": ("", "format = None, expected 7"),
    "later format": (edited("format", 8), "format = 8, expected 7"),
    "earlier format": (edited("format", 4), "format = 4, expected 7.*rotor_x"),
    "missing": (edited("mass", None), "missing mass"),
    "misspelt": (
        edited("mass", "0.028\nmas = 1.0"),
        r"unknown key 'mas' in \[body\]; did you mean 'mass' in \[body\]\?",
    ),
    "unknown": (edited("mass", "0.028\nzzz = 1.0"), r"unknown key 'zzz' in \[body\]\."),
    "wrong table": (
        edited("mass", "0.028\nlatency = 0.01"),
        r"unknown key 'latency' in \[body\]; did you mean .* \[motors\]",
    ),
    "value for a table": ("format = 7\nbody = 3\n", r"body is a value, expected a table \[body\]"),
    "text": (edited("mass", '"28 g"'), "mass = '28 g', expected a number"),
    "truth value": (edited("mass", "true"), "mass = True, expected a number"),
    "list for a number": (edited("mass", "[0.028, 0.028]"), "mass has 2 values, expected 1"),
    "table for a number": (edited("mass", "{ kg = 0.028 }"), "mass = .*, expected a number"),
    "number for a list": (edited("inertia", "1e-5"), "inertia has 1 values, expected 3"),
    "too few": (edited("inertia", "[1e-5, 1e-5]"), "inertia has shape .*, expected 3"),
    "text in a list": (edited("inertia", '[1e-5, 1e-5, "x"]'), "inertia = .*, expected 3 numbers"),
    "one out of range": (
        edited("inertia", "[1e-5, 1e-5, 13.3]"),
        r"inertia = \[1e-05, 1e-05, 13.3\] kg m2 is outside",
    ),
    "grams": (
        edited("mass", "28.0"),
        r"mass = 28.0 kg is outside its physical range \[0.005, 5\]. Check the unit",
    ),
    "negative": (edited("mass", "-0.028"), "mass = -0.028 kg is outside"),
    "nan": (edited("mass", "nan"), "mass = nan kg is outside"),
    "infinite": (edited("mass", "inf"), "mass = inf kg is outside"),
    "more than float32 holds": (edited("mass", "1e39"), "mass = .* is outside"),
    "more than float64 holds": (edited("mass", "1" + "0" * 400), "mass"),
    "more digits than Python reads": (edited("mass", "1" + "0" * 5000), "drone.toml: "),
}


@pytest.mark.parametrize(
    ("text", "message"),
    WRONG.values(),
    ids=WRONG,
)
def test_a_wrong_file_is_refused_with_its_name_and_cause(text, message):
    with pytest.raises(InputError, match=message) as caught:
        from_toml(text, "drone.toml")
    assert str(caught.value).startswith("drone.toml: ")


def test_a_drone_that_is_neither_named_nor_a_file_is_refused_with_the_names(tmp_path):
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    for place in ("crazyfly", tmp_path / "missing.toml", tmp_path, tmp_path / "binary.toml"):
        with pytest.raises(InputError, match="no such drone; ") as caught:
            read_drone(place)
        assert all(name in str(caught.value) for name in DRONES)


@pytest.mark.parametrize("name", FIELDS)
def test_every_value_has_both_its_bounds_checked(name):
    quantity = QUANTITIES[name]
    for bound, outside in ((quantity.lower, -np.inf), (quantity.upper, np.inf)):
        edge = np.full(quantity.size, bound, np.float32)
        if name in GEOMETRY:  # All of it alike would be no frame.
            edge = edge * np.sign(getattr(crazyflie(), name))
            outside = np.inf * edge
        beyond = np.nextafter(edge, np.float32(outside))
        shape = () if quantity.size == 1 else (quantity.size,)
        check(replace(crazyflie(), **{name: edge.reshape(shape)}))
        with pytest.raises(InputError, match=f"{name} = .* is outside"):
            check(replace(crazyflie(), **{name: beyond.reshape(shape)}))


def test_what_passes_the_check_can_be_written_and_read():
    """A number given as a list of one is either refused or read back."""
    drone = replace(crazyflie(), mass=[0.028])
    try:
        check(drone)
    except InputError:
        return
    from_toml(to_toml(drone, "drone"))


def test_replace_changes_one_field_and_refuses_an_unknown_one():
    heavier = replace(crazyflie(), mass=0.03)
    changed = [
        name
        for name in FIELDS
        if not np.array_equal(getattr(heavier, name), getattr(crazyflie(), name))
    ]
    assert changed == ["mass"]
    assert heavier.mass.dtype == np.float32
    with pytest.raises(
        InputError, match="unknown parameter 'weight'; known are thrust_to_weight, "
    ):
        replace(crazyflie(), weight=0.03)


def test_parameters_are_frozen_and_every_field_is_traced():
    with pytest.raises(dataclasses.FrozenInstanceError):
        crazyflie().mass = 1.0  # type: ignore[misc]
    assert len(jax.tree.leaves(crazyflie())) == len(FIELDS)


def test_noiseless_silences_the_noise_and_nothing_else():
    quiet, drone = noiseless(crazyflie()), crazyflie()
    changed = {
        name for name in FIELDS if not np.array_equal(getattr(quiet, name), getattr(drone, name))
    }
    sensors = {
        "position_noise",
        "position_noise_uniform",
        "velocity_noise",
        "attitude_noise",
        "attitude_noise_uniform",
        "gyro_noise",
    }
    assert changed == sensors | {"actuator_noise", "gyro_turn_on_bias", "gyro_bias_walk"}
    assert all(getattr(quiet, name) == 0 for name in changed)


def test_every_single_number_of_a_drone_is_a_component_once():
    singles = [name for name in FIELDS if QUANTITIES[name].size == 1]
    parts = {1: "", 2: "xy", 3: "xyz", 4: "1234"}
    vectors = [f"{name}_{part}" for name in FIELDS for part in parts[QUANTITIES[name].size]]
    assert list(COMPONENTS) == singles + vectors
    assert len(COMPONENTS) == sum(leaf.size for leaf in jax.tree.leaves(crazyflie()))
    assert len(set(COMPONENTS.values())) == len(COMPONENTS)


@given(drones(), drones())
def test_components_put_one_by_one_make_the_drone_they_were_read_from(drone, other):
    """Each component by hand from its field, and all of them back into another drone."""
    for name in COMPONENTS:
        field, axis = (
            (name[:-2], {"x": 0, "y": 1, "z": 2}.get(name[-1], ord(name[-1]) - ord("1")))
            if name[:-2] in QUANTITIES
            else (name, None)
        )
        value = np.asarray(getattr(drone, field))
        assert component(drone, name) == (value if axis is None else value[axis])
    rebuilt = replace(other, **{name: component(drone, name) for name in COMPONENTS})
    jax.tree.map(np.testing.assert_array_equal, rebuilt, drone)


def test_a_component_is_replaced_and_its_neighbours_are_kept():
    drone = replace(crazyflie(), inertia_x=2e-5, mass=0.03, torque_bias_z=1e-6)
    np.testing.assert_array_equal(drone.inertia, np.array([2e-5, 1.33e-5, 2.64e-5], np.float32))
    np.testing.assert_array_equal(drone.torque_bias, np.array([0, 0, 1e-6], np.float32))
    assert drone.mass == np.float32(0.03)
    check(drone)


def test_a_component_is_replaced_in_each_drone_of_a_batch():
    batch = jax.tree.map(lambda leaf: np.stack([leaf] * 4), crazyflie())
    values = np.linspace(1e-5, 2e-5, 4, dtype=np.float32)
    for drones in (
        replace(batch, inertia_x=values),
        replace(replace(batch, inertia_x=np.float32(1e-5)), inertia_x=values),
    ):
        assert drones.inertia.shape == (4, 3)
        np.testing.assert_array_equal(component(drones, "inertia_x"), values)
        np.testing.assert_array_equal(drones.inertia[:, 1:], batch.inertia[:, 1:])


def test_a_traced_component_is_differentiated_through():
    """d(2 x + 3 y) of inertia by hand, compiled."""

    def weighted(value):
        return replace(crazyflie(), inertia_x=value).inertia @ np.array([2, 3, 0], np.float32)

    value, slope = jax.jit(jax.value_and_grad(weighted))(np.float32(2e-5))
    assert value == pytest.approx(2 * 2e-5 + 3 * 1.33e-5, rel=1e-6)
    assert slope == 2


def laid_out(lines):
    """The good file with other lines for the frame."""
    kept = [line for line in GOOD.splitlines() if line.split(" = ")[0] not in GEOMETRY]
    place = kept.index("[body]") + 1
    return "\n".join([*kept[:place], *lines, *kept[place:]])


@pytest.mark.parametrize(("layout", "frame"), [("x", x_frame), ("+", plus_frame)])
def test_a_file_may_give_layout_and_arm_of_a_frame(layout, frame):
    drone = from_toml(laid_out([f'layout = "{layout}"', "arm_length = 0.225"]))
    for name, values in frame(0.225).items():
        np.testing.assert_array_equal(getattr(drone, name), np.float32(values))
    assert arm_length(drone) == pytest.approx(0.225, rel=1e-6)
    assert from_toml(to_toml(drone, "mine")).rotor_x[0] == drone.rotor_x[0]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["arm_length = 0.225"], "layout = None"),
        (['layout = "hex"', "arm_length = 0.225"], "layout = 'hex'"),
        (['layout = "x"', 'arm_length = "long"'], "arm_length = 'long'"),
        (['layout = "x"', "arm_length = 0.0"], "forward = 0.0"),
        (['layout = "x"', "arm_length = 0.2", "rotor_x = [1.0, 1.0, 1.0, 1.0]"], "beside rotor_x"),
        ([], "missing rotor_x, rotor_y, rotor_direction"),
    ],
)
def test_half_a_frame_in_a_file_is_refused(lines, message):
    with pytest.raises(InputError, match=message):
        from_toml(laid_out(lines), "mine.toml")


@pytest.mark.parametrize(
    "changes",
    [
        {"rotor_direction": (-1.0, -1.0, 1.0, 1.0)},  # yaw is roll
        {"rotor_direction": (1.0, 1.0, 1.0, 1.0)},
        {"rotor_direction": (-1.0, 1.0, -1.0, 0.5)},
        {"rotor_x": (0.0, 0.0, 0.0, 0.0)},
        {"rotor_x": (0.1, 0.05, 0.05, 0.1)},  # the centre of mass is behind all rotors
    ],
)
def test_a_frame_that_cannot_be_steered_is_refused(changes):
    with pytest.raises(InputError, match=r"rotor_direction|rotors at"):
        check(replace(crazyflie(), **{name: np.float32(one) for name, one in changes.items()}))


@pytest.mark.parametrize("make", [x_frame, plus_frame, lambda arm: h_frame(0.1, arm)])
@pytest.mark.parametrize("arm", [0.0, -0.1, np.nan, np.inf])
def test_a_frame_without_size_is_refused(make, arm):
    with pytest.raises(InputError):
        make(arm)


def test_a_drone_prints_in_a_line():
    text = repr(crazyflie())
    assert "mass=0.028" in text
    assert "\n" not in text
    assert len(text) < 140
