"""What a reality's name adds: `+sensors`, `+air`, `+10ms`, `+yaw6000`, `+weak10`, `+payload15`.

Virtual drones get other parameters, from the start or, as `+yaw6000@5`, in the course of a flight.
Other realities are wrapped: `SensorWrapper` reads them through the noise and delay of a Crazyflie's
sensors, `DelayWrapper` holds back their commands, and `MotorBiasWrapper` changes them as a trim in
yaw or a weak motor does.
"""

import dataclasses
import re
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight import parameters
from maidenflight.errors import InputError
from maidenflight.parameters import Parameters, arm_length, crazyflie, replace
from maidenflight.simulator.physics.disturbance import is_disturbed
from maidenflight.simulator.realities.around import (
    SENSORS,
    DelayWrapper,
    MotorBiasWrapper,
    SensorWrapper,
    milliseconds,
)
from maidenflight.simulator.realities.virtual_drone import ParameterChange, VirtualDrone

_ADDITION = re.compile(
    r"(?P<before>.+)\+(?P<what>"
    r"(?:sensors|air|\d+(?:\.\d+)?ms|yaw-?\d{1,5}|weak\d{1,2}|payload\d{1,3})(?:@\d+(?:\.\d+)?)?)"
)
_PARTS = re.compile(r"(?P<kind>[a-z]*)(?P<amount>-?[0-9.]*)(?P<unit>ms)?(?:@(?P<at>[0-9.]+))?")
_COUNTS = 65535.0
"""Of full PWM."""
_LATENCY = "latency"
AIR_TORQUE = np.array([0.012, 0.016, 0.003], np.float32)
AIR_FORCE = np.array([0.020, 0.017, 0.018], np.float32)
"""Disturbances of `+air`: torques over weight times arm, forces over weight. Geometric means of the
logs of four Crazyflies (paper/identification/nanodrone.py), from 0.4 to 2 times as large in one."""
IN_FLIGHT = ("yaw", "weak", "payload")
"""Additions that may appear in the course of a flight."""


class Perturbation(NamedTuple):
    """What a name adds, read."""

    kind: str
    """`sensors`, `air`, `latency`, `yaw`, `weak` or `payload`."""
    amount: float
    """Latency [s], trim [counts of PWM], thrust or mass [%]."""
    at: float | None
    """When it appears [s after the flight's start]; None: it holds from the start."""

    @property
    def label(self) -> str:
        """As it stands in a name."""
        amount = "" if self.kind in ("sensors", "air") else f"{self.amount:g}"
        text = milliseconds(self.amount) if self.kind == _LATENCY else f"{self.kind}{amount}"
        return text if self.at is None else f"{text}@{self.at:g}"


def split(name: str) -> tuple[str, list[str]]:
    """Splits a reality's name into its plain name and its additions, such as `["10ms"]`."""
    added: list[str] = []
    while match := _ADDITION.fullmatch(name):
        name, added = match["before"], [match["what"], *added]
    return name, added


def jump_of(name: str) -> float | None:
    """Returns when a reality of a name changes in the course of a flight [s]; None: it does not."""
    times = [_read(text).at for text in split(name)[1]]
    return next((at for at in times if at is not None), None)


def with_additions(drone: Any, added: list[str]) -> Any:
    """Returns a reality with what its name adds.

    Args:
        drone: a `VirtualDrone`, or one that follows the `Reality` protocol.
        added: of `split`.

    Raises:
        InputError: the same twice; a latency that is no whole number of the reality's steps or
            longer than a drone's may be; a trim or weak motor of a reality that does not take
            commands of its motors; a payload of a reality that is no virtual drone, or one with
            which the drone cannot hover; or a change in the course of a flight of a reality that is
            no virtual drone, of what cannot change so, or at two times.
    """
    read = [_read(text) for text in added]
    kinds = [addition.kind for addition in read]
    if len(set(kinds)) < len(kinds):
        raise InputError(f"{drone.name} + {' + '.join(added)}: expected each addition once.")
    for addition in read:
        if addition.at is not None and addition.kind not in IN_FLIGHT:
            raise InputError(
                f"{drone.name}+{addition.label}: only "
                f"{', '.join(f'+{kind}N' for kind in IN_FLIGHT)} may appear in the course of a "
                f"flight. Leave out @{addition.at:g}."
            )
        drone = (
            _with(drone, addition) if isinstance(drone, VirtualDrone) else _wrap(drone, addition)
        )
    return drone


def _read(added: str) -> Perturbation:
    """An entry of what `split` gives."""
    match = _PARTS.fullmatch(added)
    assert match is not None, added
    kind, amount = match["kind"], float(match["amount"] or 0)
    at = None if match["at"] is None else float(match["at"])
    return (
        Perturbation(_LATENCY, amount / 1000, at)
        if match["unit"]
        else Perturbation(kind, amount, at)
    )


def _with(drone: VirtualDrone, addition: Perturbation) -> VirtualDrone:
    """A virtual drone with an addition, which holds from the start or from a time on."""
    name, now, later = f"{drone.name}+{addition.label}", drone.parameters, drone.later
    if addition.at is None:
        now = _changed(now, addition, name)
    elif later is None:
        later = ParameterChange(now, addition.at)
    elif later.at != addition.at:
        raise InputError(
            f"{name}: changes at {later.at:g} s and {addition.at:g} s; expected one time. Give "
            f"both the same, such as @{later.at:g}, or fly one reality for each."
        )
    if later is not None:
        later = later._replace(parameters=_changed(later.parameters, addition, name))
    return dataclasses.replace(drone, name=name, parameters=now, later=later)


def _changed(own: Parameters, addition: Perturbation, name: str) -> Parameters:
    """A virtual drone's parameters with an addition."""
    if addition.kind == "sensors":
        return replace(own, **SENSORS)
    if addition.kind == "air":
        return in_air(own)
    if addition.kind == "yaw":
        share = addition.amount / _COUNTS
        torque = share * own.torque_to_thrust * own.thrust_to_weight * own.mass * own.gravity
        bias = np.asarray(own.torque_bias + np.array([0.0, 0.0, torque]), np.float32)
        return replace(own, torque_bias=bias)
    if addition.kind == "weak":
        thrusts = np.asarray(own.rotor_thrust * _weak(addition.amount), np.float32)
        return replace(own, rotor_thrust=thrusts)
    if addition.kind == "payload":
        heavy = loaded(own, addition.amount / 100)
        if (ratio := float(heavy.thrust_to_weight)) < 1.0:
            raise InputError(
                f"{name}: cannot lift {addition.amount:g} % more: thrust-to-weight ratio "
                f"{ratio:.3f} with this payload; expected above 1. Give less."
            )
        return parameters.check(heavy, name)
    late = replace(own, latency=float(own.latency) + addition.amount)
    return parameters.check(late, name)


def in_air(drone: Parameters) -> Parameters:
    """Returns a drone on which disturbances act: its own, else `AIR_TORQUE` and `AIR_FORCE`."""
    if is_disturbed(drone):
        return drone
    weight = float(drone.mass * drone.gravity)
    return replace(
        drone,
        disturbance_torque=np.float32(weight * arm_length(drone)) * AIR_TORQUE,
        disturbance_force=np.float32(weight) * AIR_FORCE,
    )


def loaded(drone: Parameters, share: float) -> Parameters:
    """Returns a drone with a payload at its centre of mass.

    Thrust [N], torques and air drag [N] stay.

    Args:
        drone: which; also stacked or traced.
        share: of its mass [-].
    """
    heavier = np.float32(1.0 + share)
    return replace(
        drone,
        mass=drone.mass * heavier,
        thrust_to_weight=drone.thrust_to_weight / heavier,
        drag=drone.drag / heavier,
    )


def _weak(percent: float) -> Float[np.ndarray, "4"]:
    """Shares of the motors' thrust where the first has so much less."""
    return np.array([1.0 - percent / 100, 1.0, 1.0, 1.0])


def _wrap(drone: Any, addition: Perturbation) -> Any:
    """Another reality with an addition."""
    if addition.kind in ("payload", "air") or addition.at is not None:
        raise InputError(
            f"{drone.name}+{addition.label}: {drone.name} has physics of its own, in which neither "
            "mass nor air is ours to change nor anything in the course of a flight. Expected a "
            "virtual drone, such as virtual:7, or a drone's TOML file."
        )
    if addition.kind == "sensors":
        return SensorWrapper(drone)
    if addition.kind == "yaw":
        directions = np.array(crazyflie().rotor_direction, np.float64)
        return MotorBiasWrapper(drone, addition.label, addition.amount / _COUNTS * directions)
    if addition.kind == "weak":
        return MotorBiasWrapper(drone, addition.label, np.zeros(4), _weak(addition.amount))
    return DelayWrapper(drone, addition.amount)
