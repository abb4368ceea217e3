"""Parameters of a Crazyflie 2 that others measured, identified or assumed, with their sources.

They differ with batteries, propellers, payloads and methods, by more than any source says, and so
show what is plausible, not what is true.
"""

from typing import NamedTuple

from maidenflight.parameters import component, crazyflie

PAPER = "Gronauer et al. 2022"
_FOERSTER = "Förster 2015"
_LANDRY = "Landry 2015, as in gym-pybullet-drones"
_SECONDS = "Learning to Fly in Seconds 2024"
_DELAYS = "Eschmann et al. 2024, from flights"
_RL_TOOLS = "rl_tools"
_CRAZYFLOW = "crazyflow, load cell, with markers"
_SIMPLE = "SimpleFlight 2025"
_ROTORPY = "RotorPy 3.0"
_QUADSWARM = "QuadSwarm 2023"


class Published(NamedTuple):
    """A value of a parameter that somebody else gives."""

    parameter: str
    """Name in `parameters.COMPONENTS`."""
    value: float
    """[SI]."""
    source: str


_OTHERS: dict[str, dict[str, float]] = {
    "thrust_to_weight": {
        _LANDRY: 2.25,
        _SECONDS: 2.25,
        _DELAYS: 1.97,
        _ROTORPY: 1.95,
        _SIMPLE: 1.60,
        _CRAZYFLOW: 1.49,
        _RL_TOOLS: 1.47,
    },
    "motor_time_constant": {
        _SECONDS: 0.150,
        _CRAZYFLOW: 0.136,
        _DELAYS: 0.072,
        _ROTORPY: 0.072,
        _RL_TOOLS: 0.055,
        _QUADSWARM: 0.037,
        _SIMPLE: 0.025,
    },
    "spin_down_ratio": {_RL_TOOLS: 249 / 55, _CRAZYFLOW: 106 / 136},
    "inertia_x": {
        _CRAZYFLOW: 1.68e-5,
        _FOERSTER: 1.66e-5,
        _ROTORPY: 1.43e-5,
        _LANDRY: 1.4e-5,
        _SIMPLE: 1.4e-5,
        _DELAYS: 1.03e-5,
        _RL_TOOLS: 9.4e-6,
        _SECONDS: 3.85e-6,
    },
    "inertia_y": {_CRAZYFLOW: 1.68e-5, _FOERSTER: 1.67e-5, _ROTORPY: 1.43e-5, _LANDRY: 1.4e-5},
    "inertia_z": {_CRAZYFLOW: 2.98e-5, _FOERSTER: 2.93e-5, _ROTORPY: 2.89e-5, _LANDRY: 2.17e-5},
    "torque_to_thrust": {
        _FOERSTER: 5.96e-3,
        _CRAZYFLOW: 7.35e-3,
        _LANDRY: 2.51e-2,
        _ROTORPY: 3.39e-2,
    },
    "mass": {_CRAZYFLOW: 0.0328, _SIMPLE: 0.0321, _ROTORPY: 0.030, _LANDRY: 0.027},
}
"""By parameter and source [SI]. Where a source gives two motor lags, the first is that of speeding
up and their ratio the slowdown."""


def published(parameter: str) -> list[Published]:
    """What others give for a parameter, from the largest to the smallest.

    The paper's value is not among them.

    Args:
        parameter: name in `parameters.COMPONENTS`.
    """
    known = _OTHERS.get(parameter, {})
    return [
        Published(parameter, value, source)
        for source, value in sorted(known.items(), key=lambda entry: -entry[1])
    ]


def of_the_paper(parameter: str) -> float:
    """The paper's value of a parameter; zero or one for effects that its model lacks [SI]."""
    return float(component(crazyflie(), parameter))
