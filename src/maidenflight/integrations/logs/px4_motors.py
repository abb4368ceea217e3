"""Motors of a PX4 drone: where they are, what they are told, how fast they turn.

Motors: `actuator_motors` is a share of full thrust before PX4 inverts the curve f x^2 + (1 - f) x
of its parameter THR_MDL_FAC (f), x being what is sent to the ESC; `actuator_outputs` is x, between
the output's minimum and maximum. With f > 0 thrust is taken as that curve says; without it rotor
speed is taken to follow x, and thrust is x^2.

Source: PX4 v1.14, src/lib/mixer_module/functions/FunctionMotors.hpp (updateValues),
src/modules/control_allocator/module.yaml (CA_ROTORn_PX, PY, KM), msg/EscReport.msg.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from maidenflight.errors import InputError
from maidenflight.flights.streams import streams
from maidenflight.flights.streams.streams import Stream
from maidenflight.integrations.logs import px4_setpoints
from maidenflight.integrations.logs.px4_topics import REMEDY, Parameters, Topics, columns, vector

_ORDER = (0, 3, 1, 2)
"""PX4's numbers of our motors in its default quadrotor in X."""


class Rotors(NamedTuple):
    """Where the rotors are and which way they turn."""

    order: tuple[int, ...]
    """PX4's number, from 0, of the front right, back right, back left and front left motor."""
    notes: tuple[str, ...]


def rotors(name: str, parameters: Parameters) -> Rotors:
    """The rotors' order by their places, or PX4's default."""
    count = parameters.get("CA_ROTOR_COUNT")
    placed = {
        number: (
            parameters.get(f"CA_ROTOR{number}_PX", 0.0),
            -parameters.get(f"CA_ROTOR{number}_PY", 0.0),
        )
        for number in range(int(count) if count and 0 < count <= 12 else 0)
    }
    if not any(forward or left for forward, left in placed.values()):
        if parameters.get("SYS_AUTOSTART", 0) // 1000 == 5:
            raise InputError(
                f"{name}: an airframe in + (SYS_AUTOSTART {parameters['SYS_AUTOSTART']:g}); "
                "expected four rotors in X."
            )
        return Rotors(
            _ORDER,
            (f"{name}: motors in PX4's default order; the log has no places of the rotors",),
        )
    corners = [(True, False), (False, False), (False, True), (True, True)]
    where = {number: (forward > 0, left > 0) for number, (forward, left) in placed.items()}
    size = max(np.hypot(*place) for place in placed.values())
    diagonal = all(min(abs(one), abs(other)) > 0.2 * size for one, other in placed.values())
    if len(placed) != 4 or set(where.values()) != set(corners) or not diagonal:
        places = "; ".join(f"{forward:g}, {left:g}" for forward, left in placed.values())
        raise InputError(
            f"{name}: {len(placed)} rotors at {places} m forward, left (CA_ROTORn_PX, PY); "
            "expected four in X, which is what maidenflight simulates."
        )
    order = tuple(next(number for number in where if where[number] == corner) for corner in corners)
    told = ", ".join(f"({placed[number][0]:.3g}, {placed[number][1]:.3g})" for number in order)
    notes = [f"{name}: rotors at {told} m forward, left; PX4's motors {_numbered(order)}"]
    turns = [parameters.get(f"CA_ROTOR{number}_KM", 0.0) for number in order]
    if all(turns) and [np.sign(turn) for turn in turns] != [1, -1, 1, -1]:
        notes.append(
            f"{name}: its rotors do not turn as the simulated ones, of which front right and back "
            "left turn counter-clockwise (CA_ROTORn_KM): torque_to_thrust and inertia_z found are "
            "worth nothing, and a policy for it would control yaw the wrong way round"
        )
    return Rotors(order, tuple(notes))


def _numbered(order: tuple[int, ...]) -> str:
    return ", ".join(str(number + 1) for number in order)


def motors(
    name: str, topics: Topics, parameters: Parameters, order: tuple[int, ...]
) -> tuple[Stream, list[str]]:
    """Rotor speeds that are asked for, sqrt(u) of our motors, and how they follow from topics."""
    factor = float(parameters.get("THR_MDL_FAC", 0.0))
    factor = factor if 0.0 < factor <= 1.0 else 0.0
    shares, where = _shares(name, topics, parameters, factor)
    rebuilt = px4_setpoints.motors(name, topics, parameters, shares)
    shares, where = (shares, where) if rebuilt is None else rebuilt
    ours = Stream(shares.time, shares.values[:, list(order)])
    how = (
        f"the curve of THR_MDL_FAC = {factor:g}"
        if factor
        else "the square of the command, as without THR_MDL_FAC speed follows it"
    )
    speed = ours._replace(values=np.sqrt(ours.values)) if factor else ours
    return speed, [f"{where}; thrust by {how}"]


def _shares(name: str, topics: Topics, parameters: Parameters, factor: float) -> tuple[Stream, str]:
    """Commands of PX4's motors as they were logged, and of which topic; without rows if not."""
    told = columns(topics, "actuator_motors", *vector("control", 4), clock="timestamp_sample")
    if told is not None and len(told[0]) > 1:
        # Not a number is a motor that is stopped.
        share = np.clip(np.nan_to_num(told[1], nan=0.0), 0.0, None)
        return streams.stream(told[0], share), f"{name}: motors of actuator_motors"
    sent, low, high, channels = _outputs(name, topics, parameters)
    signal = np.clip((sent[1] - low) / (high - low), 0.0, None)
    share = factor * signal**2 + (1.0 - factor) * signal
    return streams.stream(sent[0], share), (
        f"{name}: motors of actuator_outputs {_numbered(channels)} between {low.min():g} and "
        f"{high.max():g}"
    )


def _outputs(
    name: str, topics: Topics, parameters: Parameters
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray, tuple[int, ...]]:
    """Outputs of motors 1 to 4, their least and most, and their channels."""
    functions = {
        (found[1], int(found[2])): value
        for key, value in parameters.items()
        if (found := re.fullmatch(r"(\w+)_FUNC(\d{1,2})", key))
    }
    prefixes = dict.fromkeys(
        prefix for (prefix, _), value in functions.items() if value in (101, 102, 103, 104)
    )
    channels, prefix = (0, 1, 2, 3), ""
    for prefix in prefixes:
        held = {
            int(value) - 101: channel - 1
            for (owner, channel), value in functions.items()
            if owner == prefix and value in (101, 102, 103, 104)
        }
        if len(held) == 4:
            channels = tuple(held[motor] for motor in range(4))
            break
    sent = columns(topics, "actuator_outputs", *(f"output[{channel}]" for channel in channels))
    if sent is None or len(sent[0]) < 2:
        return (np.zeros(0), np.zeros((0, 4))), np.zeros(4), np.ones(4), channels

    def bound(word: str, usual: float) -> np.ndarray:
        keys = [
            (f"{prefix}_{word}{channel + 1}", f"PWM_MAIN_{word}", f"PWM_{word}")
            for channel in channels
        ]
        return np.array(
            [next((parameters[key] for key in some if parameters.get(key, 0) > 0), usual)
             for some in keys]
        )  # fmt: skip

    low, high = bound("MIN", 1000.0), bound("MAX", 2000.0)
    if not (high > low).all() or np.nanquantile(sent[1], 0.9) > 1.05 * high.max():
        raise InputError(
            f"{name}: actuator_outputs of typically {np.nanmedian(sent[1]):.4g} do not lie between "
            f"{low.min():g} and {high.max():g}, the outputs' least and most. {REMEDY}"
        )
    return sent, low, high, channels


def rotor_speed(topics: Topics, order: tuple[int, ...]) -> Stream | None:
    """Speeds of our motors that the ESCs tell [rad/s]."""
    fields = [f"esc[{number}].esc_rpm" for number in range(4)]
    told = columns(topics, "esc_status", *fields)
    if told is None or not np.any(told[1]):
        return None
    escs = _by_function(topics["esc_status"])
    return streams.stream(told[0], np.abs(told[1][:, escs][:, list(order)]) * 2 * np.pi / 60)


def _by_function(fields: Mapping[str, np.ndarray]) -> Int[np.ndarray, "4"]:
    """Which ESC drives motors 1 to 4: by their function, 101 to 104, or their number."""
    functions = [fields.get(f"esc[{number}].actuator_function") for number in range(4)]
    known = [int(one[-1]) - 101 for one in functions if one is not None and len(one)]
    return np.argsort(known) if sorted(known) == [0, 1, 2, 3] else np.arange(4)
