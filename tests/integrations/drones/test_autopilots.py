"""Parameter files of autopilots: names, types and ranges are theirs, and thrust becomes linear."""

import re

import numpy as np
import pytest

from maidenflight.deployment.drone_format import drone_text
from maidenflight.integrations.drones import thrust_curve
from maidenflight.integrations.logs.px4_allocation import Rotor, effectiveness
from maidenflight.parameters import Parameters, drone, h_frame, levers, plus_frame, replace

RACER = replace(drone("racer_5_inch"), thrust_linear=0.35, rotor_thrust=(1.0, 0.9, 1.0, 0.95))
FRAMES = {
    "square X": drone("x500"),
    "wide H": replace(RACER, **h_frame(0.08, 0.12)),
    "the other way": replace(RACER, **h_frame(0.1, 0.1, reversed_rotors=True)),
    "plus": replace(RACER, **plus_frame(0.1)),
}
RANGES = {
    "PX": (-100, 100),
    "PY": (-100, 100),
    "PZ": (-100, 100),
    "KM": (-1, 1),
    "CT": (0, 100),
}
"""Of CA_ROTORn_..., as PX4's control allocator documents them."""
PX4 = {
    "CA_AIRFRAME": (0, 15, 6),
    "CA_ROTOR_COUNT": (0, 12, 6),
    "THR_MDL_FAC": (0.0, 1.0, 9),
    "MPC_THR_HOVER": (0.1, 0.8, 9),
    **{f"CA_ROTOR{n}_{key}": (*ends, 9) for n in range(4) for key, ends in RANGES.items()},
}
"""Least and greatest value and MAVLink's type of each parameter."""


def px4_parameters(text: str) -> dict[str, float]:
    """Reads a file as QGroundControl does: five columns, tabs between them."""
    values: dict[str, float] = {}
    for line in text.splitlines():
        if line.startswith("#"):
            continue
        vehicle, component, name, value, kind = line.split("\t")
        least, most, expected = PX4[name]
        assert (vehicle, component, int(kind)) == ("1", "1", expected)
        assert least <= float(value) <= most, name
        assert name not in values
        values[name] = float(value)
    assert values.keys() == PX4.keys()
    return values


@pytest.mark.parametrize("frame", FRAMES)
def test_px4_allocates_what_our_rotors_do(frame: str) -> None:
    one = FRAMES[frame]
    values = px4_parameters(drone_text(one, "px4"))
    keys = ("PX", "PY", "CT", "KM")
    rotors = tuple(
        Rotor(*(values[f"CA_ROTOR{number}_{key}"] for key in keys)) for number in range(4)
    )
    share = np.asarray(one.rotor_thrust, float) * 6.5
    turns = levers(one) * [1.0, 1.0, float(one.torque_to_thrust)]
    # Forward, right, down: pitch, yaw and z change their signs. PX4 counts crosswise.
    expected = np.stack([turns[:, 0], -turns[:, 1], -turns[:, 2], -np.ones(4)]) * share
    np.testing.assert_allclose(effectiveness(rotors), expected[:, [0, 2, 3, 1]], rtol=1e-5)
    assert values["MPC_THR_HOVER"] == pytest.approx(1 / float(one.thrust_to_weight), rel=1e-6)


def linear(one: Parameters, factor: float) -> np.ndarray:
    """Thrust, as a share of full, that follows a demand through the inverse of the curve.

    Source: PX4, mixer_module.cpp; ArduPilot, AP_Motors_Thrust_Linearization.cpp: the same formula.
    """
    demand = thrust_curve.INPUTS
    root = np.sqrt((1.0 - factor) ** 2 + 4.0 * factor * demand)
    return thrust_curve.share(one, (root - (1.0 - factor)) / (2.0 * factor))


@pytest.mark.parametrize("bend", [0.0, 0.35, 0.9])
def test_thrust_follows_the_demand_where_the_curve_is_the_autopilots(bend: float) -> None:
    one = replace(drone("x500"), thrust_linear=bend)
    px4 = px4_parameters(drone_text(one, "px4"))["THR_MDL_FAC"]
    (ardupilot,) = re.findall(r"^MOT_THST_EXPO,(.*)$", drone_text(one, "ardupilot"), re.MULTILINE)
    assert px4 == pytest.approx(1.0 - bend, abs=1e-6)
    for factor in (px4, float(ardupilot)):
        np.testing.assert_allclose(linear(one, factor), thrust_curve.INPUTS, atol=1e-5)


def test_a_constant_part_of_the_thrust_is_lost_and_the_rest_is_as_near_as_can_be() -> None:
    one = replace(drone("x500"), thrust_offset=0.03, thrust_linear=0.2)
    factor = thrust_curve.factor(one)
    errors = {
        tried: np.square(thrust_curve.share(one, thrust_curve.INPUTS) - curve).sum()
        for tried in (factor - 0.02, factor, factor + 0.02)
        for curve in [(1 - tried) * thrust_curve.INPUTS + tried * thrust_curve.INPUTS**2]
    }
    assert min(errors, key=errors.__getitem__) == factor


def test_ardupilot_is_told_of_an_x_and_of_no_other_frame() -> None:
    names = {
        frame: re.findall(r"^(\w+),[-0-9.e]+$", drone_text(one, "ardupilot"), re.MULTILINE)
        for frame, one in FRAMES.items()
    }
    thrust = ["MOT_THST_EXPO", "MOT_THST_HOVER"]
    assert names.pop("square X") == ["FRAME_CLASS", "FRAME_TYPE", *thrust]
    assert all(found == thrust for found in names.values())


QUAD_X = {0: (-1, 1, -1), 1: (-1, -1, 1), 2: (1, 1, 1), 3: (1, -1, -1)}
"""Roll, pitch and yaw of Betaflight's own mixer, rotors "props in"."""


@pytest.mark.parametrize("frame", FRAMES)
def test_betaflight_takes_two_thirds_of_the_bend_and_mixes_for_the_frame(
    frame: str,
) -> None:
    text = drone_text(FRAMES[frame], "betaflight")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    (percent,) = re.findall(r"^set thrust_linear = (\d+)$", text, re.MULTILINE)
    assert 0 <= int(percent) <= 150
    output = thrust_curve.INPUTS
    sent = output * (1.0 + int(percent) / 100 * (1.0 - output) ** 2)
    thrust = thrust_curve.share(FRAMES[frame], sent)
    bend = np.abs(thrust_curve.share(FRAMES[frame], output) - output).max()
    assert np.abs(thrust - output).max() < 0.35 * bend
    if frame == "square X":
        assert lines == [f"set thrust_linear = {percent}", "save"]
        return
    assert lines[:2] == ["mixer CUSTOM", "mmix reset"]
    mix = np.array([line.split()[1:] for line in lines if line.startswith("mmix ")][1:], float)
    np.testing.assert_array_equal(mix[:, 0], range(4))
    np.testing.assert_array_equal(mix[:, 1], 1.0)
    own = np.array([levers(FRAMES[frame])[rotor] for rotor in (1, 0, 2, 3)])
    own[:, :2] /= np.abs(own[:, :2]).max()
    np.testing.assert_allclose(mix[:, 2:], own * [1, 1, -1], atol=1e-3)


def test_the_mixer_of_a_square_x_would_be_betaflights_own() -> None:
    """By the same formula as for other frames."""
    own = np.sign(levers(drone("x500")))[[1, 0, 2, 3]] * [1, 1, -1]
    np.testing.assert_array_equal(own, [QUAD_X[number] for number in range(4)])
