"""Which columns of a table are which signal, by the parts of their names in any order.

A name is cut into words (`drone_velocity_linear_x`, `m1_thrust`, `ang vel x`, `angVelX`); one says
which component it is, others what is measured. Columns with the same other words belong together.
"""

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

_CLOCK = {
    *("time", "timestamp", "t", "ts", "stamp", "times", "sec", "secs", "seconds", "elapsed"),
    *("us", "ms", "ns", "header"),
}
_MOTOR = {
    *("motor", "motors", "mot", "m", "pwm", "esc", "throttle", "thrust", "thrusts", "actuator"),
    *("actuators", "output", "outputs", "command", "commands", "cmd", "control", "u", "act"),
}
_SPINNING = {"rpm", "erpm", "rotor", "rotors", "speed", "speeds", "omega", "velocities"}
_ANGULAR = {
    *("ang", "angular", "gyro", "gyr", "omega", "rate", "rates", "w", "body", "adc", "dot", "rot"),
    *("gyroscope", "bodyrate", "bodyrates", "g"),
}
_TURNS = _ANGULAR - {"body", "adc", "dot", "rot", "g"}
_FORCE = {"acc", "accel", "acceleration", "accelerometer", "force", "a", "smooth", "specific"}
_QUATERNION = {"quat", "quaternion", "orientation", "q", "attitude", "att", "rotation"}
_VELOCITY, _PLACE = {"vel", "velocity", "v", "linear", "dot"}, {"pos", "position", "p"}
_AXES = ("x", "y", "z")
_SURE = {"gyro", "gyr", "quat", "quaternion", "orientation"}
"""Words that tell most."""
_PLAIN = {
    *("drone", "state", "estimate", "est", "field", "pose", "vehicle", "imu", "sensor", "data"),
    *("local", "uav", "quad", "raw", "combined", "world", "unfilt", "m", "s", "xyz", "twist"),
    *("kalman", "stabilizer", "calib", "filtered", "odom", "odometry"),
}
_FOREIGN = {
    *("sp", "setpoint", "ref", "reference", "target", "des", "desired", "goal", "covariance"),
    *("variance", "bias", "mag", "dmot", "residual", "error", "gate", "wind", "alpha", "prior"),
    *("integral", "temperature", "current", "snap", "jerk", "r", "corners"),
}
"""Words of set-points and other things that are no signal of the drone."""
_ALL = _CLOCK | _MOTOR | _SPINNING | _ANGULAR | _FORCE | _QUATERNION | _VELOCITY | _PLACE | _PLAIN
_WORDS = sorted((word for word in _ALL if len(word) > 2), key=len, reverse=True)
_COMPONENTS = {
    **{letter: letter for letter in "xyzw0123456789"},
    **{"roll": "x", "pitch": "y", "yaw": "z", "phi": "x", "theta": "y", "psi": "z"},
}
_ROLLED = {"roll", "pitch", "yaw", "phi", "theta", "psi", "r", "p"}
_UNIT = re.compile(
    r"[\[(]\D[^\])]*[\])]?|_(rad_?s|deg_?s|dps|rad|deg|m_?s2|mps2|mss|m_?s|mps|mg?|g|m?v)$"
)
"""Ends of columns' names that tell units."""
_BATTERY = {"battery", "bat", "vbat", "voltage", "vbattery", "volt", "volts"}


class Column(NamedTuple):
    """What a column's name says."""

    words: tuple[str, ...]
    """All but the component."""
    component: str
    """x, y, z, w or a digit; empty if none."""
    is_turn: bool
    """Whether the component is a roll, pitch or yaw."""


class Names(NamedTuple):
    """What the names of a table's columns say."""

    signals: Mapping[str, tuple[str, ...]]
    """Columns by signal, as `signal_map.COUNTS` has them; angles in roll, pitch, yaw are three."""
    clock: str
    """Column of the time; empty if none."""
    clocks: Mapping[str, str]
    """Columns with times of single signals, by signal."""


def read_names(columns: Iterable[str]) -> Names:
    """Finds the signals in columns by their names."""
    parsed = {name: parse(name) for name in columns}
    groups: dict[tuple[tuple[str, ...], bool], dict[str, str]] = {}
    for name, column in parsed.items():
        groups.setdefault((column.words, column.is_turn), {}).setdefault(column.component, name)
    for (words, is_turn), parts in groups.items():
        others = groups.get((words, False), {})
        if is_turn and set(parts) == {"x", "y"} and set(others) >= {"y"} > set("x") & set(others):
            parts["z"] = others["y"]  # omega.r, omega.p, omega.y
    choices: dict[str, tuple[int, tuple[str, ...], tuple[str, ...]]] = {}
    for (words, is_turn), parts in groups.items():
        for signal, chosen in _signals(set(words), is_turn, parts):
            extra = len(words) + 2 * any(word not in _ALL for word in words)
            extra -= 2 * bool(set(words) & _SURE or len(chosen) > len(_AXES))
            if signal not in choices or extra < choices[signal][0]:
                choices[signal] = extra, chosen, words
    times = {
        column.words: name
        for name, column in reversed(parsed.items())
        if set(column.words) & _CLOCK
    }
    alone = [name for words, name in reversed(times.items()) if set(words) <= _CLOCK | _PLAIN]
    clock = min(alone, key=lambda name: len(parsed[name].words), default="")
    own = {}
    for signal, (_, _, words) in choices.items():
        for at, name in times.items():
            if set(at) - _CLOCK and set(at) - _CLOCK == set(words) - {"m", "q"}:
                own[signal] = name
    return Names({signal: chosen for signal, (_, chosen, _) in choices.items()}, clock, own)


def parse(name: str) -> Column:
    """Cuts a column's name into words and its component."""
    plain = _UNIT.sub("", name.strip())
    split = re.sub(r"([a-z])([A-Z])", r"\1 \2", plain).lower()
    tokens = re.findall(r"[a-z]+|\d+", split)
    words: list[str] = []
    for token in tokens:
        words.extend(_cut(token))
    places = [index for index, word in enumerate(words) if word in _COMPONENTS]
    if len(words) > 1 and words[-1] in ("r", "p") and set(words[:-1]) & _TURNS:
        return Column(tuple(words[:-1]), {"r": "x", "p": "y"}[words[-1]], True)
    if words in (["p"], ["q"], ["r"]):
        return Column(("rate",), dict(zip("pqr", "xyz", strict=True))[words[0]], True)
    if not places:
        return Column(tuple(words), "", False)
    index = places[-1]
    rest = tuple(words[:index] + words[index + 1 :])
    return Column(rest, _COMPONENTS[words[index]], words[index] in _ROLLED)


def _cut(token: str) -> list[str]:
    """Cuts letters into known words and a component, such as angvelx or vx; whole if unknown."""
    rest, words = token, []
    while len(rest) > 1 and rest not in _ALL and rest not in _COMPONENTS:
        known = next(
            (word for word in (*_WORDS, "roll", "pitch", "yaw") if rest.startswith(word)), ""
        )
        if not known and len(rest) == 2 and rest[0] in "vqwpag" and rest[1] in "xyzw":
            known = rest[0]
        if not known:
            return [token]
        words.append(known)
        rest = rest[len(known) :]
    return [*words, *([rest] if rest else [])]


def _signals(
    words: set[str], is_turn: bool, parts: Mapping[str, str]
) -> Iterable[tuple[str, tuple[str, ...]]]:
    """Yields the signals that columns of the same words may be, each with them in order."""
    if words & _FOREIGN or ("d" in words and words & _MOTOR):
        return
    vector = tuple(parts[axis] for axis in "xyz") if set("xyz") <= set(parts) else ()
    numbers = sorted(component for component in parts if component.isdigit())
    first = int(numbers[0]) if numbers else 0
    listed = tuple(
        parts[str(first + offset)] for offset in range(4) if str(first + offset) in parts
    )
    if "" in parts and words & _BATTERY and not words & _CLOCK:
        yield "battery", (parts[""],)
    if vector or (len(numbers) == 3 and first == 0):
        signal = _vector(words, is_turn)
        three = vector or listed
        if signal == "attitude" and not is_turn:
            if "w" in parts:
                yield signal, (*vector, parts["w"])
        elif signal:
            yield signal, three
    if len(listed) == 4:
        if words & _QUATERNION and not words & _MOTOR:
            yield "attitude", (*listed[1:], listed[0])
        elif words & _SPINNING:
            yield "rotor_speed", listed
        elif words & _MOTOR:
            yield "motors", listed


def _vector(words: set[str], is_turn: bool) -> str:
    """Says which signal three components are; "" if none that is known."""
    known = words - _PLAIN
    turning = bool(known & _TURNS) or (known == {"g"}) or (is_turn and "dot" in known)
    if known & _FORCE:
        return "" if known & {"ang", "angular", "rot"} or is_turn else "accelerometer"
    if turning:
        return "body_rates"
    if known & _QUATERNION:
        return "attitude"
    if known & _VELOCITY:
        return "" if is_turn else "velocity"
    if is_turn:
        return "attitude"
    return "position" if not known or known <= _PLACE | {"body"} else ""
