"""Each format is flown by the program that reads it, beside our simulator, and loses what it says.

What a format holds is the nearest drone of our model: readers have to fly that within 1 %. What it
does not hold is the difference between that drone and the original in our simulator alone, and
stands in the file.
"""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from readers import READERS, SECONDS, Flown

from arrays import float64
from maidenflight.deployment.drone_format import digits, drone_text, losses
from maidenflight.parameters import Parameters, check, drone, h_frame, replace, x_frame
from maidenflight.registry import DRONE_FORMATS
from maidenflight.simulator.physics import dynamics

RPM = 20e3
STEP_S = 5e-4
DRONES: dict[str, Parameters] = {
    "x500": drone("x500"),
    "all effects": check(
        replace(
            drone("crazyflie_2.0"),
            thrust_offset=0.02,
            thrust_linear=0.2,
            spin_down_ratio=1.4,
            motor_coasting=0.05,
            latency=0.018,
            rotor_thrust=(1.0, 0.9, 0.95, 1.0),
            rotor_momentum=6e-5,
            drag=(0.3, 0.25, 0.1),
            flapping_moment=(2e-4, 3e-4),
            torque_bias=(1e-5, -2e-5, 1e-5),
        ),
        "all effects",
    ),
    "turning the other way": replace(
        drone("racer_5_inch"), **h_frame(0.09, 0.12, reversed_rotors=True), gravity=9.81
    ),
}
MANOEUVRES = {
    "hover": (1.0, np.ones(4)),
    "free fall": (0.0, np.zeros(4)),
    "a step of roll": (1.0, 1.0 + 0.01 * np.array([-1, -1, 1, 1])),
    "a step of yaw": (1.0, 1.0 + 0.05 * np.array([-1, 1, -1, 1])),
    "a step of thrust": (1.0, np.full(4, 1.1)),
}
"""Thrusts before and from the start on, in shares of a quarter of the weight."""
SIMULATORS = list(READERS)
TOLERANCE = 0.01
"""Of the largest velocity, rate and tilt that a manoeuvre has."""
BEYOND = {
    # Drag that grows with rotor speed is none of rotors that stand.
    ("urdf", "all effects", "free fall"): 0.03,
    ("rotorpy", "all effects", "free fall"): 0.03,
    # Drag at the rotors' places brakes yaw, too.
    ("sdf", "all effects", "a step of yaw"): 0.12,
    ("rotorpy", "all effects", "a step of yaw"): 0.12,
}
"""What programs simulate and our model does not, as the pages say."""


@jax.jit
def _fly(one: Parameters, before: Any, after: Any, times: Any) -> dynamics.State:
    level = jnp.zeros(4).at[3].set(1.0)
    start = dynamics.State(jnp.zeros(3), jnp.zeros(3), level, jnp.zeros(3), before)

    def step(state: dynamics.State, time: Any) -> tuple[dynamics.State, None]:
        # The step in which the command arrives sees its mean, as far as it acts.
        acts = jnp.clip((time + STEP_S - one.latency) / STEP_S, 0.0, 1.0)
        return dynamics.rk4(state, before + acts * (after - before), one), None

    return lax.scan(step, start, times)[0]


def ours(one: Parameters, *thrusts: np.ndarray) -> Flown:
    """The manoeuvre in our simulator, of thrusts [N] of each rotor."""
    full = float(one.mass * one.gravity * one.thrust_to_weight) / 4 * np.asarray(one.rotor_thrust)
    with jax.enable_x64(True):
        fine = jax.tree.map(float64, replace(one, time_step=np.float32(STEP_S)))
        # A rotor that stands has no slope in the formula for its speed.
        beyond = [np.maximum(each / full - float(one.thrust_offset), 1e-12) for each in thrusts]
        speeds = [dynamics.speed_for(float64(share), fine) for share in beyond]
        state = _fly(fine, *speeds, float64(np.arange(round(SECONDS / STEP_S)) * STEP_S))
    return Flown(*(np.asarray(part) for part in state[:4]))


def thrusts(one: Parameters, manoeuvre: str) -> tuple[np.ndarray, np.ndarray]:
    before, after = MANOEUVRES[manoeuvre]
    quarter = float(one.mass * one.gravity) / 4
    return np.full(4, before * quarter), after * quarter


def error(found: Flown, expected: Flown) -> float:
    """The largest difference of velocity, attitude or body rates, by the largest value of each.

    Moments of less than 0.1 mm/s, 0.1 mrad/s and 0.1 mrad are none.
    """
    shares = []
    for part in ("velocity", "quaternion", "body_rates"):
        one, other = (np.asarray(getattr(state, part), float) for state in (found, expected))
        if part == "quaternion":
            one, other = (2.0 * np.sign(each[3]) * each[:3] for each in (one, other))
        size = max(np.abs(other).max(), 0.01)
        shares.append(np.abs(one - other).max() / size)
    return float(max(shares))


@pytest.mark.parametrize("name", DRONES)
@pytest.mark.parametrize("to", SIMULATORS)
def test_the_program_that_reads_a_file_flies_the_drone_that_it_holds(
    to: str, name: str, tmp_path: Path
) -> None:
    original = DRONES[name]
    held = DRONE_FORMATS[to].nearest(original)
    text = drone_text(original, to, name.replace(" ", "_"), full_speed=RPM)
    for manoeuvre in MANOEUVRES:
        before, after = thrusts(original, manoeuvre)
        found, expected = READERS[to](text, before, after, tmp_path), ours(held, before, after)
        most = BEYOND.get((to, name, manoeuvre), TOLERANCE)
        assert error(found, expected) < most, (manoeuvre, found, expected)


@pytest.mark.parametrize("to", DRONE_FORMATS.own)
def test_what_a_format_does_not_hold_stands_in_the_file_with_its_value(to: str) -> None:
    original = DRONES["all effects"]
    held = DRONE_FORMATS[to].nearest(original)
    text = drone_text(original, to, full_speed=RPM)
    for line in losses(original, held):
        assert line in text
    unheld = {line.split(" = ")[0] for line in losses(original, held)}
    assert ("latency" in unheld) == (to != "mjcf")
    assert "torque_bias" in unheld
    assert losses(DRONES["x500"], DRONES["x500"]) == []


def test_numbers_are_the_shortest_decimals_of_their_float32() -> None:
    assert digits(np.float32(0.1), [1.0, -0.0]) == "0.1 1 0"
    assert np.float32(digits(np.float32(1 / 3))) == np.float32(1 / 3)


def test_a_plus_hovers_too() -> None:
    """Rotors on the axes: no lever of theirs is a square's."""
    plain = replace(drone("crazyflie"), **x_frame(0.05))
    assert "mixer CUSTOM" not in drone_text(plain, "betaflight")
