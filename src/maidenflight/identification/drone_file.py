"""The drone file: parameters, and how they were identified, as a TOML file.

`DroneFile` holds, reads and writes all that such a file says; a damaged one is refused.

```toml
format = 7
[motors] # [body], [sensors], [battery], [simulation]: the parameters

[identification] # how they were found, if they were: objective, ...
[identification.source] # the flights
[identification.estimates.latency] # value, interval, search bounds, ...
[identification.unidentified] # plausible range of what the flights cannot tell
[[identification.gains]] # log-likelihood gain of each group of parameters
[[identification.warnings]] # what makes flights and values doubtful

[posterior] # samples of both
[record] # version, seed, inputs and settings
```
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from maidenflight import inputs, parameters, results
from maidenflight.errors import InputError
from maidenflight.flights.checkup.result import LogWarning, read_warning
from maidenflight.flights.log import SUBSAMPLED, ZERO_ORDER_HOLD
from maidenflight.identification.posterior import Posterior
from maidenflight.identification.unknowns import check_body
from maidenflight.inputs import Fields, StrPath
from maidenflight.parameters import COMPONENTS, DRONES, Parameters
from maidenflight.registry import PLOTS
from maidenflight.simulator.physics.battery import COUNTS, MOST_COUNTS

CLOSED_LOOP = "closed_loop"
OBJECTIVES = ("likelihood", "replay", CLOSED_LOOP)
"""What an identification optimises."""
COMMANDS = (ZERO_ORDER_HOLD, SUBSAMPLED, "mixed")
"""What the commands of an identification's logs stood for."""
SAVED = 200
"""Samples of the posterior that a file holds, whose standard deviation is then within 5 %: by
definition of it, 1 / sqrt(2 N) of a normal sample."""
_ENDS = "valley", "bounds", "plausible"
_CURE = "Identify again."
"""What to do where a file is damaged."""


@dataclass(frozen=True)
class Estimate:
    """One identified parameter, in its SI unit."""

    value: float
    """The best of all trials."""
    interval: tuple[float, float]
    """95 % interval, from how segments of flight differ."""
    trials: tuple[float, ...]
    """Best value of each trial: how they differ shows how well the optimiser does."""
    between_sd: float
    """Standard deviation beyond noise: how much the drone itself, or what the model lacks, varies.
    Between flights, each counted alike, for thrust and constant torques where there are enough of
    them; else between segments of flight."""
    valley: tuple[float, float] | None = None
    """Lowest and highest value at which, the other parameters at their best, a replay's objective
    is at most 1 % above its lowest; `None` for a likelihood."""
    bounds: tuple[float, float] | None = None
    """What it was searched within."""
    plausible: tuple[float, float] | None = None
    """What was plausible about the start, before the flights."""

    @property
    def trial_mean(self) -> float:
        """Mean over the trials, as in the paper's table."""
        return float(np.mean(self.trials))

    @property
    def trial_sd(self) -> float:
        """Standard deviation over the trials, as in the paper's table."""
        return float(np.std(self.trials))


@dataclass(frozen=True)
class GroupGain:
    """The log-likelihood gain of adding a group of parameters, on held-out flights."""

    group: str
    """Its name, of `selection.GROUPS`."""
    log_likelihood_gain: float
    """Mean gain of a row [nats]."""
    standard_error: float | None
    """Standard error of that gain, over segments of flight [nats]; `None` of a single segment."""
    is_in_model: bool
    """Whether the parameters were identified."""
    reason: str | None = None
    """Why they were not."""


@dataclass(frozen=True)
class Advice:
    """What makes the interval of a parameter narrower."""

    parameter: str
    """Its name."""
    action: str
    """What to log or fly next."""
    interval: tuple[float, float] | None
    """95 % interval to expect then, SI units; `None` where that is not known."""


@dataclass(frozen=True)
class Source:
    """The flights that an identification rests on."""

    flights: int
    """How many; segments of one count as one."""
    seconds: float
    """Flight that was used [s]."""
    simulated: bool
    """Whether any of it was."""
    commands: str
    """What logged commands stood for, of `COMMANDS`."""
    full_scale_counts: float
    """Counts of a Crazyflie's firmware that u = 1 stands for."""


@dataclass(frozen=True)
class Search:
    """How the values were found."""

    objective: str
    """What was optimised, of `OBJECTIVES`."""
    value: float
    """Of the objective at the optimum: mean loss of a window of a replay, minus the mean log
    likelihood of a row [nats], or the mean squared difference of behaviour in the closed loop."""
    windows: int
    """Windows that the flights were cut into; in the closed loop, flights."""
    evaluations: int
    """Evaluations of the objective."""


@dataclass(frozen=True)
class DroneFile:
    """All that a drone file says."""

    parameters: Parameters
    """The drone."""
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    """The identified parameters, by name; none for a drone that was not identified."""
    posterior: Posterior = field(default_factory=lambda: Posterior({}))
    """Joint samples of the parameters that were identified and of those that could not be."""
    source: Source | None = None
    """The flights, of an identified drone."""
    search: Search | None = None
    """How the values were found, of an identified drone."""
    gains: tuple[GroupGain, ...] = ()
    """Gain of each group of parameters that was tried, where the flights chose them."""
    unidentified: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Plausible range of each parameter that the flights cannot tell, by name, SI units."""
    record: Mapping[str, Any] = field(default_factory=dict)
    """How the file was made; see `results.record`."""
    name: str = "drone.toml"
    """Of the file, for errors."""
    advice: tuple[Advice, ...] = ()
    """What makes intervals narrower."""
    warnings: tuple[LogWarning, ...] = ()
    """What makes its flights and values doubtful."""

    @property
    def full_scale_counts(self) -> float:
        """Firmware counts of u = 1 in the drone's flights; 60000 of a drone without any."""
        return COUNTS if self.source is None else self.source.full_scale_counts

    @property
    def ensemble(self) -> Any:
        """The posterior samples as drones to train over."""
        return self.posterior.ensemble(self.parameters, self.name)

    def plot(self) -> Any:
        """Returns a picture of the estimates and their intervals, which a notebook shows."""
        return PLOTS["identification"](self)

    def to_toml(self, name: str) -> str:
        """Returns the TOML text of a drone of that name, the same for the same content."""
        extra: dict[str, Any] = {}
        if self.source is not None and self.search is not None:
            extra["identification"] = {
                **_table(self.search),
                "source": _table(self.source),
                "estimates": {name: _table(estimate) for name, estimate in self.estimates.items()},
            }
            if self.unidentified:
                extra["identification"]["unidentified"] = {
                    name: _plain(ends) for name, ends in self.unidentified.items()
                }
            for key in ("gains", "advice", "warnings"):
                entries = getattr(self, key)
                if entries:
                    extra["identification"][key] = [_table(entry) for entry in entries]
        if self.posterior:
            samples = np.stack(list(self.posterior.values()), axis=1)[:SAVED]
            extra["posterior"] = {
                "names": list(self.posterior),
                "samples": [_plain(row) for row in samples.tolist()],
            }
        if self.record:
            extra["record"] = dict(self.record)
        return parameters.to_toml(self.parameters, name, extra)

    @classmethod
    def read(cls, drone: StrPath) -> "DroneFile":
        """Reads a drone file, or returns a named drone.

        Raises:
            InputError: neither a named drone nor a readable file, or something in it is damaged; or
                the named drone has no mass of its own.
        """
        if str(drone) in DRONES:
            return cls(parameters.read_drone(drone), name=str(drone))
        document = parameters.document(drone)
        path = str(drone)
        result = cls(
            parameters.from_document(document, path),
            posterior=_posterior(document, path),
            record=_record(document, path),
            name=path,
        )
        if "identification" not in document:
            check_body(result.parameters, path)
            return result
        table = Fields(document["identification"], path, "identification", _CURE)
        estimates, source = table.table("estimates"), table.table("source")
        gains = tuple(map(_gain, table.tables("gains")))
        advice = tuple(map(_advice, table.tables("advice")))
        unidentified = table.table("unidentified") if "unidentified" in table.content else None
        result = dataclasses.replace(
            result,
            estimates={name: _estimate(estimates, name) for name in estimates.content},
            source=_source(source),
            search=Search(
                table.choice("objective", OBJECTIVES),
                table.number("value"),
                table.count("windows"),
                table.count("evaluations"),
            ),
            gains=gains,
            advice=advice,
            warnings=tuple(map(read_warning, table.tables("warnings"))),
            unidentified={} if unidentified is None else _ranges(unidentified),
        )
        table.end()
        return result

    def write(self, path: StrPath) -> Path:
        """Writes the file; the drone is named after it.

        Raises:
            WriteError: the file cannot be written.
        """
        return results.write(path, self.to_toml(Path(path).stem))


read = DroneFile.read


def _table(content: Any) -> dict[str, Any]:
    """Fields of a dataclass as TOML holds them; without those that are `None`."""
    return {
        name: _plain(value)
        for name, value in dataclasses.asdict(content).items()
        if value is not None
    }


def _plain(value: Any) -> Any:
    """Numbers to six digits, which no interval is as narrow as."""
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _estimate(estimates: Fields, name: str) -> Estimate:
    table = estimates.table(name)
    if name not in COMPONENTS:
        raise table.refused(name, "a parameter of a drone as its title")
    known = {key: table.ends(key) for key in _ENDS if key in table.content}
    numbers = table.numbers("trials"), table.number("between_sd", 0.0)
    result = Estimate(table.number("value"), table.ends("interval"), *numbers, **known)
    table.end()
    return result


def _ranges(table: Fields) -> dict[str, tuple[float, float]]:
    for name in table.content:
        if name not in COMPONENTS:
            raise table.refused(name, "a parameter of a drone as its name")
    return {name: table.ends(name) for name in table.content}


def _source(table: Fields) -> Source:
    result = Source(
        table.count("flights"),
        table.number("seconds", 0.0),
        table.flag("simulated"),
        table.choice("commands", COMMANDS),
        table.number("full_scale_counts", 1.0, MOST_COUNTS),
    )
    table.end()
    return result


def _gain(table: Fields) -> GroupGain:
    result = GroupGain(
        table.text("group"),
        table.number("log_likelihood_gain"),
        table.number("standard_error", 0.0) if "standard_error" in table.content else None,
        # Files before the field had its name.
        table.flag("kept" if "kept" in table.content else "is_in_model"),
        table.text("reason") if "reason" in table.content else None,
    )
    table.end()
    return result


def _advice(table: Fields) -> Advice:
    ends = table.ends("interval") if "interval" in table.content else None
    result = Advice(table.text("parameter"), table.text("action"), ends)
    table.end()
    return result


def _posterior(document: Mapping[str, Any], source: str) -> Posterior:
    if "posterior" not in document:
        return Posterior({})
    table = Fields(document["posterior"], source, "posterior", _CURE)
    names, rows = table.get("names"), table.get("samples")
    table.end()
    sound = (
        isinstance(names, list)
        and isinstance(rows, list)
        and names
        and rows
        and all(isinstance(name, str) and name in COMPONENTS for name in names)
        and len(set(names)) == len(names)
        and all(
            isinstance(row, list) and len(row) == len(names) and all(map(inputs.is_number, row))
            for row in rows
        )
    )
    if not sound or not names:
        raise InputError(
            f"{source}: [posterior] needs names = parameters and samples = [[a number for each of "
            "them], ...]. Identify again."
        )
    return Posterior(dict(zip(names, np.array(rows, np.float64).T, strict=True)))


def _record(document: Mapping[str, Any], source: str) -> dict[str, Any]:
    record = document.get("record", {})
    if not isinstance(record, dict):
        raise InputError(f"{source}: record is a value, expected a table [record]. Remove it.")
    results.recorded_inputs(record, source)
    return record
