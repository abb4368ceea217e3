"""The flight plan: which manoeuvres a flight for identification consists of, as a TOML file.

```toml
format = 1
seed = 0 # of random steps
room = [2.0, 2.0, 1.5] # width, depth, height [m]; the drone takes off in the middle
height = 0.8 # of the point about which it flies [m]

[[manoeuvres]] # flown in this order, with a rest at the point after each
kind = "steps_x"
size = 0.15
period = 0.5
seconds = 8.0

[expected.latency] # half widths of 95 % intervals to expect, SI units
plan = 0.001
hover = 0.004
plausible = 0.015

[extremes] # of the flight in simulation
[record] # version, seed, inputs and settings
```
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from jaxtyping import Float

from maidenflight import inputs, results
from maidenflight.errors import InputError
from maidenflight.flights.manoeuvres import HOVER, LONGEST, MOTORS, RATE, SHORTEST, Manoeuvre
from maidenflight.inputs import Fields, StrPath
from maidenflight.parameters import COMPONENTS

FORMAT = 1
"""Version of the file."""
REST = 1.0
"""Time at the point after each manoeuvre [s]."""
LONGEST_PLAN = 600.0
"""Longest flight [s]."""
_CURE = "Plan again: maidenflight plan."


@dataclass(frozen=True)
class Block:
    """A manoeuvre and how long it is flown."""

    manoeuvre: Manoeuvre
    seconds: float


@dataclass(frozen=True)
class ExpectedWidths:
    """Half widths of the 95 % interval of a parameter, in its SI unit."""

    plan: float
    """To expect from the plan."""
    hover: float
    """From as many seconds of calm hover."""
    plausible: float
    """Of the range that is plausible beforehand, which neither exceeds."""


@dataclass(frozen=True)
class Extremes:
    """How far a simulated flight went."""

    lateral_x: float
    """Largest distance from the take-off along x [m]."""
    lateral_y: float
    lowest: float
    """Height [m]."""
    highest: float
    tilt: float
    """[rad]."""
    speed: float
    """[m/s]."""
    astray: float
    """Largest distance from the set-point [m]."""
    sunk: float
    """Largest distance below the set-point [m]."""
    at_limits: float
    """Share of the motors' commands that are 0 or full."""


@dataclass(frozen=True)
class FlightPlan:
    """What a flight for identification consists of."""

    blocks: tuple[Block, ...]
    """In the order of the flight."""
    room: tuple[float, float, float]
    """Width, depth and height [m]; the drone takes off in the middle of the floor."""
    height: float
    """Of the point about which it flies [m]."""
    seed: int = 0
    """Of random steps."""
    expected: Mapping[str, ExpectedWidths] = field(default_factory=dict)
    """By parameter; empty where nothing was requested."""
    extremes: Extremes | None = None
    """Of the flight on the drones that it was planned for."""
    record: Mapping[str, Any] = field(default_factory=dict)
    """How it was made; see `results.record`."""
    name: str = "plan.toml"
    """Of the file, for errors."""

    @property
    def seconds(self) -> float:
        """Length of the flight, rests included [s]."""
        return sum(block.seconds + REST for block in self.blocks)

    @property
    def by_setpoints(self) -> bool:
        """Whether a real drone that follows positions and yaw can fly it."""
        return all(block.manoeuvre.by_setpoints for block in self.blocks)

    def setpoints(self) -> Float[np.ndarray, "N 4"]:
        """Returns the position [m], above the take-off, and yaw [rad], each 10 ms."""
        parts = [np.zeros((0, 4))]
        for number, block in enumerate(self.blocks):
            part = block.manoeuvre.setpoints(block.seconds, self.seed + number)
            parts += [part, np.zeros((round(REST * RATE), 4))]
        return np.concatenate(parts) + np.array([0.0, 0.0, self.height, 0.0])

    def excitation(self) -> Float[np.ndarray, "N"]:
        """Returns the share of full thrust by which each motor is raised or lowered, each 10 ms."""
        parts = [np.zeros(0)]
        for block in self.blocks:
            here = block.manoeuvre.size if block.manoeuvre.kind == MOTORS else 0.0
            parts.append(np.full(round(block.seconds * RATE), here))
            parts.append(np.zeros(round(REST * RATE)))
        return np.concatenate(parts)

    def to_toml(self) -> str:
        """Returns the file's text, the same for the same content."""
        document = tomlkit.document()
        document.add(tomlkit.comment("A flight for identification, SI units."))
        content: dict[str, Any] = {
            "format": FORMAT,
            "seed": self.seed,
            "room": list(self.room),
            "height": self.height,
            "manoeuvres": [
                {**dataclasses.asdict(block.manoeuvre), "seconds": block.seconds}
                for block in self.blocks
            ],
            "expected": {name: _rounded(widths) for name, widths in self.expected.items()},
            "extremes": _rounded(self.extremes) if self.extremes else {},
            "record": dict(self.record),
        }
        for name, value in content.items():
            if value != {}:
                document.add(name, tomlkit.item(value))
        return tomlkit.dumps(document)

    def write(self, path: StrPath) -> Path:
        """Writes the file.

        Raises:
            WriteError: the file cannot be written.
        """
        return results.write(path, self.to_toml())


def hovering(plan: FlightPlan) -> FlightPlan:
    """Makes a plan of as many seconds of calm hover in the same room."""
    block = Block(Manoeuvre(HOVER), plan.seconds - REST)
    return dataclasses.replace(plan, blocks=(block,), expected={}, extremes=None)


def _rounded(content: ExpectedWidths | Extremes) -> dict[str, float]:
    return {name: float(f"{value:.6g}") for name, value in dataclasses.asdict(content).items()}


def read(path: StrPath) -> FlightPlan:
    """Reads a plan.

    Raises:
        InputError: no file that can be read, or something in it is damaged.
    """
    source = str(path)
    document = inputs.toml_file(path, "a flight plan", f"Make one: maidenflight plan -o {source}.")
    table = Fields(document, source, "plan", _CURE)
    if table.get("format") != FORMAT:
        raise table.refused("format", f"{FORMAT}, that of a flight plan of this version")
    room, seed = table.numbers("room"), table.get("seed")
    if len(room) != 3 or not all(0.5 <= size <= 100.0 for size in room):
        raise table.refused("room", "[width, depth, height] of 0.5 to 100 m")
    if type(seed) is not int or not 0 <= seed < 2**31:
        raise table.refused("seed", "a whole number from 0 on")
    blocks = tuple(_block(entry, source) for entry in table.tables("manoeuvres"))
    if not blocks:
        raise table.refused("manoeuvres", "at least one table [[manoeuvres]]")
    expected = table.table("expected") if "expected" in table.content else None
    extremes = table.table("extremes") if "extremes" in table.content else None
    record = table.get("record") or {}
    if not isinstance(record, dict):
        raise table.refused("record", "a table [record]")
    results.recorded_inputs(record, source)
    result = FlightPlan(
        blocks,
        (room[0], room[1], room[2]),
        table.number("height", 0.3, room[2]),
        seed,
        {} if expected is None else _expectations(expected),
        None if extremes is None else _extremes(extremes),
        record,
        source,
    )
    table.end()
    return _fitting(result)


def _fitting(plan: FlightPlan) -> FlightPlan:
    """The plan, if its set-points stay in its room and it is no longer than a battery lasts."""
    places = plan.setpoints()
    reach = np.abs(places[:, :2]).max(axis=0)
    top = places[:, 2].max()
    if (2 * reach > plan.room[:2]).any() or top > plan.room[2] or places[:, 2].min() < 0:
        raise InputError(
            f"{plan.name}: its set-points reach {reach[0]:.2f} and {reach[1]:.2f} m from the "
            f"take-off and {top:.2f} m high, beyond its room of "
            f"{'x'.join(f'{size:g}' for size in plan.room)} m. {_CURE}"
        )
    if plan.seconds > LONGEST_PLAN:
        raise InputError(
            f"{plan.name}: {plan.seconds:g} s of flight; at most {LONGEST_PLAN:g} s. {_CURE}"
        )
    return plan


def _block(table: Fields, source: str) -> Block:
    part = Manoeuvre(
        table.text("kind"), table.number("size", 0.0), table.number("period", SHORTEST, LONGEST)
    )
    block = Block(part.checked(source), table.number("seconds", 0.5, LONGEST_PLAN))
    table.end()
    return block


def _expectations(table: Fields) -> dict[str, ExpectedWidths]:
    result = {}
    for name in table.content:
        entry = table.table(name)
        if name not in COMPONENTS:
            raise table.refused(name, "a parameter of a drone as its title")
        widths = (entry.number(part, 0.0) for part in ("plan", "hover", "plausible"))
        result[name] = ExpectedWidths(*widths)
        entry.end()
    return result


def _extremes(table: Fields) -> Extremes:
    names = [field.name for field in dataclasses.fields(Extremes)]
    result = Extremes(*(table.number(name) for name in names))
    table.end()
    return result
