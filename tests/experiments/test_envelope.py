"""How far policies fly along each axis: what counts as flown, what each grade makes of a drone."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import polars
import pytest
from hypothesis import given
from hypothesis import strategies as st

from maidenflight.errors import InputError
from maidenflight.experiments import envelope
from maidenflight.experiments.envelope import AXES, Condition, SpeedRamp
from maidenflight.flying.rows import Rows
from maidenflight.parameters import check, crazyflie, replace
from maidenflight.policy import untrained_policy
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.realities.virtual_drone import virtual_drone
from maidenflight.simulator.tasks.look_ahead import LookAhead
from numpy_drone import NumpyDrone

DRONE = virtual_drone(7)
CONDITIONS = {name: axis for name, axis in AXES.items() if isinstance(axis, Condition)}
PACES = {name: axis for name, axis in AXES.items() if isinstance(axis, SpeedRamp) and axis.of}


def rows(distance: Any) -> Rows:
    """A flight that is so far beside its set-point, row by row [m]."""
    zero = np.zeros((len(distance), 3))
    beside = zero + np.asarray(distance)[:, None] * [0.0, 1.0, 0.0]
    fields = dict.fromkeys(Rows._fields, zero) | {"true_position": beside}
    return Rows(**fields)  # type: ignore[arg-type]


def test_a_flight_is_flown_up_to_the_first_second_whose_mean_is_too_far():
    assert envelope.steps_done(rows(np.full(500, 0.09)), 100) == 500
    assert envelope.steps_done(rows(np.full(500, 0.11)), 100) == 0
    # From row 300 on at 0.2 m: the mean over 100 rows exceeds 0.1 m with 51 of them.
    late = np.where(np.arange(500) < 300, 0.0, 0.2)
    assert envelope.steps_done(rows(late), 100) == 300 - 49
    # A short slip within the mean is none, and a guard ends the flight at once.
    slip = np.where((np.arange(500) > 200) & (np.arange(500) < 230), 0.2, 0.01)
    assert envelope.steps_done(rows(slip), 100) == 500
    lost = np.where(np.arange(500) < 300, 0.01, 0.3)
    assert envelope.steps_done(rows(lost), 100) == 300
    assert envelope.steps_done(rows(np.where(np.arange(500) < 50, 0.0, np.nan)), 100) == 0
    # Where estimates drift they are judged: here they are always at the set-point.
    assert envelope.steps_done(rows(lost), 100, estimated=True) == 500


def test_policies_are_judged_about_the_task_that_they_were_trained_for():
    assert envelope.choose_axes("circle") == ("speed", "gusts")
    assert envelope.choose_axes("fast_circle") == ("circle", "gusts")
    assert envelope.choose_axes("hover") == envelope.choose_axes("my.csv") == ("gusts",)


@pytest.mark.parametrize("axis", PACES)
@pytest.mark.parametrize("thrust", [1.3, 1.8])
def test_at_the_limit_of_speed_all_thrust_is_needed(axis, thrust):
    """The reference's own acceleration, and gravity, together are k_F g."""
    drone = replace(crazyflie(), thrust_to_weight=thrust)
    reality = type(DRONE)("drone", drone)
    fastest = envelope.limit(axis, reality)
    pace = PACES[axis].of
    assert pace is not None
    reference = pace(fastest)
    velocity = lambda time: jax.jvp(reference, (time,), (jnp.ones_like(time),))[1]  # noqa: E731
    push = jax.vmap(lambda time: jax.jvp(velocity, (time,), (jnp.ones_like(time),))[1])
    sideways = np.linalg.norm(push(jnp.linspace(31.0, 40.0, 4000)), axis=1).max()
    assert math.hypot(sideways, 9.81) == pytest.approx(thrust * 9.81, rel=2e-3)


@pytest.mark.parametrize("name", CONDITIONS)
def test_every_grade_is_a_possible_drone_and_the_first_is_the_drone_itself(name):
    condition = CONDITIONS[name]
    assert list(condition.grades) == sorted(set(condition.grades))
    assert condition.grades[0] == 0.0
    for grade in condition.grades:
        for number in range(5):
            check(condition.changed(DRONE.parameters, grade, number), f"{name} {grade}")
    first = condition.changed(DRONE.parameters, 0.0, 3)
    jax.tree.map(np.testing.assert_array_equal, first, DRONE.parameters)


def test_a_payload_leaves_the_rotors_thrust_as_it_is_and_weighs():
    loaded = CONDITIONS["payload"].changed(DRONE.parameters, 0.25, 0)
    speed = jnp.full(4, 0.9)
    np.testing.assert_allclose(
        dynamics.rotor_forces(speed, loaded),
        dynamics.rotor_forces(speed, DRONE.parameters),
        rtol=1e-5,
    )
    assert float(loaded.mass) == pytest.approx(1.25 * float(DRONE.parameters.mass))


@given(st.floats(0.0, 100.0, width=32))
def test_a_gust_blows_for_a_second_of_four_and_never_more_than_its_wind(time):
    windy = replace(crazyflie(), wind=(3.0, -4.0, 0.0))
    wind = np.asarray(envelope.gust(windy, jnp.float32(time)).wind)
    strength = float(np.linalg.norm(wind))
    assert strength <= 5.0 + 1e-5
    assert strength == 0.0 or wind[0] / wind[1] == pytest.approx(-0.75, rel=1e-4)
    if time % 4.0 >= 1.0:
        assert strength == 0.0
    assert float(envelope.gust(windy, jnp.float32(4.5)).wind[0]) == pytest.approx(3.0)


def flights(reached: Any, axis: str = "circle", limit: float = 2.0) -> polars.DataFrame:
    return polars.DataFrame(
        {
            "policy": "one",
            "reality": "virtual:7",
            "axis": axis,
            "flight": range(1, len(reached) + 1),
            "reached": list(map(float, reached)),
            "unit": "m/s",
            "hardest": 3.0,
            "limit": limit,
        }
    )


def test_the_envelope_is_what_nineteen_of_twenty_flights_reach():
    reached = [0.3, 1.0, *np.linspace(1.1, 2.0, 18)]
    (row,) = envelope.summary(flights(reached)).to_dicts()
    assert row["envelope"] == 1.0
    assert row["low"] <= row["envelope"] <= row["high"]
    assert row["flights"] == 20
    (none,) = envelope.summary(flights([float("nan")] * 2 + [1.0] * 18)).to_dicts()
    assert math.isnan(none["envelope"])
    (one,) = envelope.summary(flights([float("nan")] + [1.0] * 19)).to_dicts()
    assert one["envelope"] == 1.0


@pytest.fixture
def short(monkeypatch: Any) -> None:
    monkeypatch.setattr(envelope, "DURATION_S", 0.1)


@pytest.mark.slow
def test_flights_of_every_policy_and_grade_have_the_same_starts(short: None) -> None:
    """In a tenth of a second nothing is lost, so that the hardest grade is reached."""
    policies = [
        untrained_policy(jax.random.key(number), spec=PolicySpec(look_ahead=LookAhead(2, 0.2)))
        for number in range(2)
    ]
    found = envelope.envelope(policies, DRONE, "latency", flights=3)
    assert found["reached"].to_list() == [AXES["latency"].grades[-1]] * 6  # type: ignore[union-attr]
    assert found["policy"].to_list() == ["policy_1"] * 3 + ["policy_2"] * 3
    assert found["flight"].to_list() == [1, 2, 3] * 2
    assert set(found["reality"]) == {"virtual:7"}


def test_what_cannot_be_flown_is_refused():
    policies = [untrained_policy(jax.random.key(0))]
    with pytest.raises(InputError, match="no such axis"):
        envelope.envelope(policies, DRONE, "fastness")
    with pytest.raises(InputError, match="at least one policy"):
        envelope.envelope([], DRONE, "circle")
    with pytest.raises(InputError, match="not ours to change"):
        envelope.envelope(policies, NumpyDrone(), "payload")
