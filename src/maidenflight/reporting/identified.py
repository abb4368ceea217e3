"""What a drone's file says of its identification: values, how sure they are, and the flights that
they come from.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from maidenflight.errors import InputError
from maidenflight.parameters import COMPONENTS
from maidenflight.policy import numbers
from maidenflight.reporting import text

COMMANDS = ("held", "sampled", "held and sampled")
"""What the commands of logs may be taken as."""
Kinds = frozenset[bool | None]
"""Of flights, whether they were of a simulated drone; holds `None` where some may be of either
kind."""
UNKNOWN: Kinds = frozenset([None])
SIMULATED: Kinds = frozenset([True])
REAL: Kinds = frozenset([False])
_MOST = 1e9
"""What neither a number of flights nor of seconds comes near."""


@dataclass(frozen=True)
class Estimate:
    """An identified parameter, SI units."""

    value: float
    interval: tuple[float, float]
    """95 %."""
    spread: float | None = None
    """Standard deviation between stretches of flight, where it is known."""


class Bought(NamedTuple):
    """What adding a group of parameters bought: log likelihood a row on flights held out, and its
    standard error [nats].
    """

    group: str
    gain: float
    error: float
    kept: bool


@dataclass(frozen=True)
class Origin:
    """Where a drone's parameters come from, as far as its file tells."""

    flights: int | None = None
    seconds: float | None = None
    """Of flight."""
    kinds: Kinds = UNKNOWN
    """Whether those flights were of a simulated drone."""
    commands: str = ""
    """What the logs' commands were taken as, one of `COMMANDS`; empty where that is not known."""
    windows: int | None = None
    logs: int = 0
    """Files of flights that its record names."""
    bought: tuple[Bought, ...] = ()


def table(content: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """The table `[identification]`.

    Raises:
        InputError: it is a value.
    """
    told = content.get("identification", {})
    if not isinstance(told, dict):
        raise InputError(
            f"{path}: identification is a value, expected a table [identification]. Identify again."
        )
    return told


def estimates(content: Mapping[str, Any], path: Path) -> dict[str, Estimate]:
    """The identified parameters.

    Raises:
        InputError: one without a number or an interval.
    """
    found = {}
    for name, entry in table(content, path).items():
        if name in COMPONENTS and isinstance(entry, dict):
            interval = entry.get("interval")
            told = [
                _number(number)
                for number in (
                    entry.get("value"),
                    *(interval if isinstance(interval, list) else []),
                )
            ]
            value, low, high = told if len(told) == 3 else (None, None, None)
            if value is None or low is None or high is None or low > high:
                raise InputError(
                    f"{path}: [identification.{name}] needs value = a number and interval = "
                    "[lower, upper]. Identify again."
                )
            spread = _number(entry.get("spread"))
            found[name] = Estimate(
                value, (low, high), spread if spread is not None and spread >= 0 else None
            )
    return found


def objective(content: Mapping[str, Any], path: Path) -> str:
    """Which objective was searched.

    Raises:
        InputError: one that there is not.
    """
    kind = table(content, path).get("kind", "replay")
    if kind not in ("replay", "likelihood"):
        raise InputError(
            f"{path}: [identification] kind = {kind!r}, expected 'replay' or 'likelihood'. "
            "Identify again."
        )
    return kind


def posterior(content: Mapping[str, Any], path: Path) -> dict[str, np.ndarray]:
    """Draws of the identified parameters.

    Raises:
        InputError: they are no numbers, or not one for each parameter.
    """
    told = content.get("posterior")
    if told is None:
        return {}
    try:
        names = [name for name in told["names"] if name in COMPONENTS]
        draws = numbers(told["draws"]).astype(np.float64)
        shape = (max(len(draws), 1), len(names))
        sound = (
            len(set(names)) == len(told["names"]) > 0
            and draws.shape == shape
            and np.isfinite(draws).all()
        )
    except (KeyError, TypeError, ValueError, OverflowError):
        names, draws, sound = [], np.empty(0), False
    if not sound:
        raise InputError(
            f"{path}: [posterior] needs names = parameters and draws = [[a number for each of "
            "them], ...]. Identify again."
        )
    return {name: draws[:, place] for place, name in enumerate(names)}


def origin(content: Mapping[str, Any], kinds: Kinds = UNKNOWN) -> Origin:
    """Where the parameters come from.

    What is of a wrong kind counts as not told: nothing but words hangs on it.

    Args:
        content: of the drone's file.
        kinds: of the flights, as far as others tell.
    """
    told = content.get("identification")
    if not isinstance(told, dict):
        return Origin()
    seconds, commands, flights = (
        _number(told.get("seconds")),
        told.get("commands"),
        _count(told.get("flights")),
    )
    return Origin(
        flights=flights,
        seconds=seconds if seconds is not None and 0 < seconds < _MOST else None,
        kinds=_kinds(told.get("simulated"), flights, kinds),
        commands=commands if isinstance(commands, str) and commands in COMMANDS else "",
        windows=_count(told.get("windows")),
        logs=len(inputs(content.get("record"))),
        bought=tuple(_bought(told.get("bought"))),
    )


def _kinds(any_simulated: Any, flights: int | None, others: Kinds) -> Kinds:
    """The file says whether any flight was simulated, which leaves open whether all were."""
    if any_simulated is False:
        return REAL
    if any_simulated is True:
        return SIMULATED if flights == 1 else others | SIMULATED
    return others


def source(told: Origin, before: str, after: str = "") -> str:
    """How many flights there were and of which kind, and between the two texts their seconds.

    Empty where that is not known.
    """
    word = {SIMULATED: "simulated ", REAL: "real ", SIMULATED | REAL: "real and simulated "}.get(
        told.kinds, ""
    )
    count, noun = (told.logs, "flight log") if told.flights is None else (told.flights, "flight")
    if not count:
        return ""
    seconds = "" if told.seconds is None else f"{before}{told.seconds:.0f} s{after}"
    some = ", some or all simulated" if told.kinds == SIMULATED | UNKNOWN else ""
    return f"{text.plural(count, word + noun)}{seconds}{some}"


def inputs(record: Any) -> set[str]:
    """Hashes of the flight logs that a record names."""
    named = record.get("inputs") if isinstance(record, dict) else None
    return (
        {str(entry).rpartition("sha256:")[2] for entry in named if ".toml" not in str(entry)}
        if isinstance(named, list)
        else set()
    )


def kinds_of(used: set[str], known: Mapping[str, bool | None], otherwise: Kinds) -> Kinds:
    """Kinds of flights.

    Args:
        used: hashes of their logs.
        known: by hash of a log, whether its flight was simulated.
        otherwise: the answer where no record tells which logs were used.
    """
    return frozenset(known.get(each) for each in used) if used else otherwise


def _bought(told: Any) -> Iterator[Bought]:
    for entry in told if isinstance(told, list) else []:
        if isinstance(entry, dict):
            group, gain, error, kept = (
                entry.get("group"),
                _number(entry.get("gain")),
                _number(entry.get("error")),
                entry.get("kept"),
            )
            if (
                isinstance(group, str)
                and gain is not None
                and error is not None
                and isinstance(kept, bool)
            ):
                yield Bought(group, gain, error, kept)


def _number(value: Any) -> float | None:
    return float(value) if type(value) in (int, float) and -1e30 < value < 1e30 else None


def _count(value: Any) -> int | None:
    return value if type(value) is int and 0 < value < _MOST else None
