"""Motors of a PX4 drone: where they are, what they are told, how fast they turn.

Motors: `actuator_motors` is a share of full thrust before PX4 inverts the curve f x^2 + (1 - f) x
of its parameter THR_MDL_FAC (f), x being what is sent to the ESC; `actuator_outputs` is x, between
the output's minimum and maximum. With f > 0 thrust is taken as that curve says; without it rotor
speed is taken to follow x, and thrust is x^2.

Source: MAVLink, common.xml (MAV_TYPE); PX4 v1.12, src/drivers/dshot/DShot.h (1 to 1999); v1.14,
ROMFS/px4fmu_common/init.d/airframes (SYS_AUTOSTART), src/drivers/uavcan/module.yaml (8191),
src/lib/mixer_module/functions/FunctionMotors.hpp (updateValues),
src/modules/control_allocator/module.yaml (CA_ROTORn_PX, PY, KM), msg/EscReport.msg.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from maidenflight.errors import InputError
from maidenflight.flights.streams import joining, streams
from maidenflight.flights.streams.streams import Stream
from maidenflight.integrations.logs import px4_setpoints
from maidenflight.integrations.logs.px4_topics import Parameters, Topics, columns, vector

_ORDER = (0, 3, 1, 2)
"""PX4's numbers of our motors in its default quadrotor in X (source: airframes, see above)."""


_QUADROTORS = (0, 2)
"""MAV_TYPE of a generic vehicle, which says nothing, and of a quadrotor."""
_VEHICLES = {
    **{1: "fixed wing", 3: "coaxial helicopter", 4: "helicopter", 7: "airship", 8: "balloon"},
    **{10: "rover", 11: "boat", 12: "submarine", 13: "hexarotor", 14: "octorotor"},
    **{15: "tricopter", 16: "flapping wing", 19: "tail-sitter of two rotors"},
    **{20: "tail-sitter of four rotors", 21: "tilt-rotor", 22: "VTOL", 23: "tail-sitter"},
    **{24: "tilt-wing", 25: "VTOL", 29: "dodecarotor", 35: "decarotor"},
}
"""Airframes by MAV_TYPE (source: common.xml)."""
_AIRFRAMES = {
    **{1: "fixed wing", 2: "VTOL", 3: "tilt-rotor", 4: "tail-sitter", 5: "rover", 6: "rover"},
    **{7: "motors in six degrees of freedom", 8: "multirotor with tilt", 9: "custom airframe"},
    **{10: "helicopter", 11: "helicopter", 12: "coaxial helicopter"},
}
"""Airframes by CA_AIRFRAME (source: control_allocator/module.yaml), but 0, a multirotor."""
_FRAMES = {
    **{2: "fixed wing", 3: "flying wing", 5: "quadrotor in +", 6: "hexarotor", 7: "hexarotor"},
    **{8: "octorotor", 9: "octorotor", 11: "coaxial hexarotor", 12: "coaxial octorotor"},
    **{13: "VTOL", 14: "tricopter", 15: "helicopter", 16: "helicopter", 17: "autogyro"},
    **{18: "balloon", 24: "dodecarotor", 50: "rover", 60: "submarine"},
}
"""Airframes by the thousands of SYS_AUTOSTART (source: init.d/airframes)."""
_DSHOT_MOST, _CAN_MOST = 1999, 8191
"""Full throttle of PX4's outputs to DShot and to ESCs on a CAN bus, see the source above."""


def check_airframe(name: str, parameters: Parameters) -> None:
    """Refuses airframes other than a quadrotor, before anything else is looked at.

    Raises:
        InputError: what it is, and which parameter says so.
    """

    def whole_number(key: str) -> int:
        return int(parameters.get(key, 0))

    rotors = whole_number("CA_ROTOR_COUNT")
    vehicle = _AIRFRAMES.get(whole_number("CA_AIRFRAME")), "CA_AIRFRAME"
    if vehicle[0] is None and "CA_AIRFRAME" in parameters and rotors == 4:
        return  # The allocation of the motors is what flies; the others are for display.
    if vehicle[0] is None and whole_number("MAV_TYPE") not in _QUADROTORS:
        vehicle = _VEHICLES.get(whole_number("MAV_TYPE"), "another vehicle"), "MAV_TYPE"
    if vehicle[0] is None and not rotors:
        vehicle = _FRAMES.get(whole_number("SYS_AUTOSTART") // 1000), "SYS_AUTOSTART"
    if vehicle[0] is not None:
        raise InputError(
            f"{name}: its airframe is another: {vehicle[0]} "
            f"({vehicle[1]} {whole_number(vehicle[1])}); "
            "expected a quadrotor in X, the frame that logs are read of."
        )


class Rotors(NamedTuple):
    """Where the rotors are and which way they turn."""

    order: tuple[int, ...]
    """PX4's number, from 0, of the front right, back right, back left and front left motor."""
    notes: tuple[str, ...]


def rotors(name: str, parameters: Parameters) -> Rotors:
    """Returns the rotors' order by their places, or PX4's default."""
    count = parameters.get("CA_ROTOR_COUNT")
    placed = {}
    for number in range(int(count) if count and 0 < count <= 12 else 0):
        forward, right = (parameters.get(f"CA_ROTOR{number}_P{axis}", 0.0) for axis in "XY")
        placed[number] = forward, -right
    if not any(forward or left for forward, left in placed.values()):
        note = f"{name}: motors in PX4's default order; the log has no places of the rotors"
        return Rotors(_ORDER, (note,))
    corners = [(True, False), (False, False), (False, True), (True, True)]
    quadrants = {number: (forward > 0, left > 0) for number, (forward, left) in placed.items()}
    size = max(np.hypot(*position) for position in placed.values())
    diagonal = all(min(abs(forward), abs(left)) > 0.2 * size for forward, left in placed.values())
    if len(placed) != 4 or set(quadrants.values()) != set(corners) or not diagonal:
        places = "; ".join(f"{forward:g}, {left:g}" for forward, left in placed.values())
        raise InputError(
            f"{name}: {len(placed)} rotors at {places} m forward, left (CA_ROTORn_PX, PY); "
            "expected four in X, the frame that logs are read of."
        )
    number_at = {corner: number for number, corner in quadrants.items()}
    order = tuple(number_at[corner] for corner in corners)
    text = ", ".join(f"({placed[number][0]:.3g}, {placed[number][1]:.3g})" for number in order)
    notes = [
        f"{name}: rotors at {text} forward, left (CA_ROTORn; their scale does not matter to PX4, "
        f"nor here); PX4's motors {_numbered(order)}"
    ]
    turns = [parameters.get(f"CA_ROTOR{number}_KM", 0.0) for number in order]
    if all(turns) and [np.sign(turn) for turn in turns] != [1, -1, 1, -1]:
        notes.append(joining.note_reversed_rotors(name, "CA_ROTORn_KM"))
    return Rotors(order, tuple(notes))


def _numbered(order: tuple[int, ...]) -> str:
    return ", ".join(str(number + 1) for number in order)


def motors(
    name: str, topics: Topics, parameters: Parameters, order: tuple[int, ...]
) -> tuple[Stream, list[str]]:
    """Returns the commanded rotor speeds, sqrt(u) of our motors, and how topics give them."""
    factor = 0.0 if square_since(parameters) else float(parameters["THR_MDL_FAC"])
    shares, origin = _shares(name, topics, parameters, factor)
    rebuilt = px4_setpoints.motors(name, topics, parameters, shares)
    shares, origin = (shares, origin) if rebuilt is None else rebuilt
    ours = Stream(shares.time, shares.values[:, list(order)])
    if factor:
        law = f"the curve of THR_MDL_FAC = {factor:g}"
        return ours._replace(values=np.sqrt(ours.values)), [f"{origin}; thrust by {law}"]
    law = "the square of the command, as without THR_MDL_FAC speed follows it"
    return ours, [f"{origin}; thrust by {law}"]


def square_since(parameters: Parameters) -> str:
    """Returns what lets thrust be taken as the square of the throttle; empty of another curve."""
    factor = parameters.get("THR_MDL_FAC")
    if factor is not None and 0.0 < factor <= 1.0:
        return ""
    return "THR_MDL_FAC is " + ("not logged" if factor is None else f"{factor:g}")


def _shares(name: str, topics: Topics, parameters: Parameters, factor: float) -> tuple[Stream, str]:
    """Commands of PX4's motors as they were logged, and of which topic; without rows if not."""
    logged = columns(topics, "actuator_motors", *vector("control", 4), clock="timestamp_sample")
    if logged is not None and len(logged[0]) > 1:
        # Not a number is a motor that is stopped.
        share = np.clip(np.nan_to_num(logged[1], nan=0.0), 0.0, None)
        return streams.stream(logged[0], share), f"{name}: motors of actuator_motors"
    sent, low, high, channels = _outputs(name, topics, parameters)
    signal = np.clip((sent[1] - low) / (high - low), 0.0, None)
    share = factor * signal**2 + (1.0 - factor) * signal
    return streams.stream(sent[0], share), (
        f"{name}: motors of actuator_outputs {_numbered(channels)} between {low.min():g} and "
        f"{high.max():g}{_protocol(high)}"
    )


def _protocol(high: np.ndarray) -> str:
    return {_DSHOT_MOST: " (DShot)", _CAN_MOST: " (CAN)"}.get(int(high.max()), "")


def _outputs(
    name: str, topics: Topics, parameters: Parameters
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray, tuple[int, ...]]:
    """Outputs of motors 1 to 4, their least and most, and their channels."""
    functions = {
        (match[1], int(match[2])): value
        for key, value in parameters.items()
        if (match := re.fullmatch(r"(\w+)_FUNC(\d{1,2})", key))
    }
    by_prefix: dict[str, dict[int, int]] = {}
    for (prefix, channel), value in functions.items():
        if value in (101, 102, 103, 104):
            by_prefix.setdefault(prefix, {})[int(value) - 101] = channel - 1
    whole = [prefix for prefix, outputs in by_prefix.items() if len(outputs) == 4]
    prefix = next(iter([*whole, *reversed(by_prefix)]), "")
    channels = tuple(by_prefix[prefix][motor] for motor in range(4)) if whole else (0, 1, 2, 3)
    sent = columns(topics, "actuator_outputs", *(f"output[{channel}]" for channel in channels))
    if sent is None or len(sent[0]) < 2:
        return (np.zeros(0), np.zeros((0, 4))), np.zeros(4), np.ones(4), channels

    def bound(word: str, usual: float) -> np.ndarray:
        bounds = []
        for channel in channels:
            keys = f"{prefix}_{word}{channel + 1}", f"PWM_MAIN_{word}", f"PWM_{word}"
            known = (parameters[key] for key in keys if parameters.get(key, 0) > 0)
            bounds.append(next(known, usual))
        return np.array(bounds)

    turning = sent[1][sent[1] > 0]
    typical = float(np.median(turning)) if len(turning) else 0.0
    if _is_dshot(prefix, turning, parameters):
        # PX4 applies the outputs' least and most to PWM alone.
        idle = max(1.0, float(parameters.get("DSHOT_MIN", 0.0)) * _DSHOT_MOST)
        low, high = np.full(4, idle), np.full(4, float(_DSHOT_MOST))
    else:
        usual = (1.0, float(_CAN_MOST)) if prefix == "UAVCAN_EC" else (1000.0, 2000.0)
        low, high = bound("MIN", usual[0]), bound("MAX", usual[1])
    if not (high > low).all() or not 0.9 * low.min() <= typical <= 1.05 * high.max():
        hint = " They look like raw commands to ESCs on a CAN bus, 0 to 8191."
        hint = hint if 2200.0 < typical <= _CAN_MOST else ""
        raise InputError(
            f"{name}: actuator_outputs of typically {typical:.4g} do not lie between "
            f"{low.min():g} and {high.max():g}, the outputs' least and most.{hint} Log "
            "actuator_motors, which PX4 does since 1.13."
        )
    return sent, low, high, channels


def _is_dshot(prefix: str, turning: Float[np.ndarray, "M"], parameters: Parameters) -> bool:
    """Returns whether outputs are DShot's 1 to 1999, by parameters or by numbers below PWM's."""
    if prefix == "UAVCAN_EC" or not len(turning) or turning.max() > _DSHOT_MOST + 1:
        return False
    timers = (key for key in parameters if re.fullmatch(r"PWM_(MAIN|AUX)_TIM\d", key))
    own = [parameters[key] for key in timers if key.startswith(prefix or "PWM_MAIN")]
    if any(-5 <= value <= -2 for value in own):
        return True
    return parameters.get("DSHOT_CONFIG", 0) > 0 or float(np.mean(turning < 900)) > 0.05


def rotor_speed(topics: Topics, order: tuple[int, ...]) -> Stream | None:
    """Speeds of our motors that the ESCs tell [rad/s]."""
    fields = [f"esc[{number}].esc_rpm" for number in range(4)]
    speeds = columns(topics, "esc_status", *fields)
    if speeds is None or not np.any(speeds[1]):
        return None
    escs = _by_function(topics["esc_status"])
    return streams.stream(speeds[0], np.abs(speeds[1][:, escs][:, list(order)]) * 2 * np.pi / 60)


def _by_function(fields: Mapping[str, np.ndarray]) -> Int[np.ndarray, "4"]:
    """Which ESC drives motors 1 to 4: by their function, 101 to 104, or their number."""
    functions = [fields.get(f"esc[{number}].actuator_function") for number in range(4)]
    motor_numbers = [
        int(field[-1]) - 101 for field in functions if field is not None and len(field)
    ]
    return np.argsort(motor_numbers) if sorted(motor_numbers) == [0, 1, 2, 3] else np.arange(4)
