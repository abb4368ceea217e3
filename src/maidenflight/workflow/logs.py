"""From logs to a drone: record, identify, validate."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import polars

from maidenflight import manifest, parameters, results, run_folder
from maidenflight.flights import log, recording
from maidenflight.flights.reading import COMMANDS, MOST, Flights, read_flights
from maidenflight.flights.windows import LEAD_IN
from maidenflight.identification import drone_file
from maidenflight.identification.bounds import at_bounds
from maidenflight.identification.drone_file import DroneFile
from maidenflight.identification.estimates import Identification
from maidenflight.identification.identify import identify
from maidenflight.identification.likelihood import Likelihood, log_likelihood
from maidenflight.identification.prediction import predicted_windows, prediction_error
from maidenflight.identification.progress import Progress
from maidenflight.identification.replay import Replay
from maidenflight.inputs import StrPath
from maidenflight.parameters import Parameters
from maidenflight.reporting.identification_picture import identification_picture
from maidenflight.simulator.reality import AnyReality


def record(
    drone: AnyReality,
    seed: int,
    folder: StrPath,
    truth: StrPath,
    count: int,
    duration: float,
    excitation: float,
    rate: int = recording.RATE,
    firmware: str = "2021.10",
    controller: str = "pid",
) -> list[Path]:
    """Records flights in a reality: one CSV a flight in `folder`.

    The true parameters of a virtual drone are written to `truth`, and what another reality tells
    of its own in `parameters`, if it does.
    """
    settings = {
        "reality": drone.name,
        "flights": count,
        "duration": duration,
        "excitation": excitation,
        "rate": rate,
        "firmware": firmware,
        **({} if controller == "pid" else {"controller": controller}),
    }
    made = results.record(seed=seed, inputs=[], settings=settings)
    flown = recording.record(
        drone,
        jax.random.key(seed),
        count,
        duration,
        excitation,
        rate=rate,
        firmware=firmware,
        controller=controller,
    )
    own = getattr(drone, "parameters", None)
    if isinstance(own, Parameters):
        DroneFile(own, record=made).write(truth)
    else:
        Path(truth).unlink(missing_ok=True)
    written = [log.write(Path(folder) / f"{flight.name}.csv", flight, made) for flight in flown]
    results.remove_older(written, made)
    manifest.append(folder, "record", {"logs": written, "truth": [truth]}, made)
    return written


@dataclass(frozen=True)
class Reading:
    """How logs are read."""

    most_seconds: float = MOST
    """Flight to use [s]; of more, segments of every flight are."""
    commands: str | None = None
    """What commands stand for where logs do not say it; see `read_flights`."""
    battery_law: str | None = None
    """By which PWM is read as thrust, a key of `compensation.LAWS`; the logs decide unless
    given."""
    ignore: tuple[str, ...] = ()
    """Signals of `log.OPTIONAL` to pass over, to judge what is found without them."""
    on_file: Callable[[int, int], None] | None = None
    """Called with (files read, files found)."""

    def flights(self, logs: StrPath, lead_in: int = LEAD_IN) -> Flights:
        """Reads logs; see `read_flights`."""
        return read_flights(
            logs,
            self.on_file,
            self.most_seconds,
            lead_in,
            self.commands,
            self.battery_law,
            self.ignore,
        )

    @property
    def settings(self) -> dict[str, Any]:
        """What of it shapes the result, for a record."""
        return {
            "most_seconds": self.most_seconds,
            "commands": self.commands,
            "battery_law": self.battery_law,
            "ignore": list(self.ignore) or None,
        }


@dataclass(frozen=True)
class Start:
    """The drone that an identification begins with."""

    drone: str = "crazyflie"
    """Name in `parameters.DRONES`, or a TOML file."""
    mass: float | None = None
    """Of what flew [kg]; the drone's own unless given."""

    def read(self) -> DroneFile:
        """The drone; see `parameters.read` for the errors."""
        if self.drone in parameters.DRONES:
            return DroneFile(parameters.read(self.drone, self.mass), name=self.drone)
        file = drone_file.read(self.drone)
        return dataclasses.replace(file, parameters=parameters.read(self.drone, self.mass))

    def notes(self, flights: Flights) -> list[str]:
        """Asks for the mass where nobody gave it, of real flights."""
        given = self.mass is not None or self.drone not in parameters.DRONES
        if given or all(flight.simulated for flight in flights):
            return []
        mass = 1e3 * float(parameters.read(self.drone).mass)
        return [
            f"mass taken from {self.drone}, {mass:.4g} g. Inertia, trim and other torques found "
            "are in proportion to it; thrust-to-weight ratio, lags and drag do not depend on it. "
            "Weigh yours with battery and decks, and give --mass GRAMS."
        ]


def identify_from(
    logs: StrPath,
    seed: int,
    output: StrPath,
    settings: Likelihood | Replay | None = None,
    *,
    start: Start | None = None,
    over: Sequence[str] | str | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    reading: Reading | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> tuple[Flights, Identification]:
    """Identifies a drone from logs.

    Writes `output` (TOML) and beside it every evaluation and a picture, to `run_folder.beside` and
    `run_folder.picture_beside`. `settings` is `Likelihood()` unless given; the other arguments are
    as of `identify`.
    """
    settings = Likelihood() if settings is None else settings
    reading = Reading() if reading is None else reading
    start = Start() if start is None else start
    begun = start.read()
    flights = reading.flights(logs, settings.lead_in)
    found = identify(
        flights,
        settings,
        start=begun.parameters,
        over=over,
        bounds=bounds,
        key=jax.random.key(seed),
        on_progress=on_progress,
    )
    made = results.record(
        seed=seed,
        inputs=flights.paths,
        settings={
            "start": Path(start.drone).name,
            "mass": start.mass,
            "over": over if isinstance(over, str) else list(over or found.estimates),
            "objective": found.objective,
            **dataclasses.asdict(settings),
            **reading.settings,
            "bounds": {name: list(pair) for name, pair in (bounds or {}).items()},
        },
    )
    more = (*start.notes(flights), *_kept_at_bounds(begun, found))
    found = dataclasses.replace(found, notes=(*found.notes, *more)) if more else found
    found.write(output, made)
    run_folder.EVALUATIONS.write(run_folder.beside(output), found.search)
    picture = identification_picture(found, begun.parameters)
    results.write(run_folder.picture_beside(output), picture)
    written: manifest.Files = {
        "drone": [output],
        "evaluations": [run_folder.beside(output)],
        "picture": [run_folder.picture_beside(output)],
    }
    manifest.append(output, "identify", written, made, {"logs": flights.paths})
    return flights, found


def _kept_at_bounds(start: DroneFile, found: Identification) -> list[str]:
    """What was kept of a start although it lay at a search bound there."""
    return [
        f"kept from {Path(start.name).name}: {said}"
        for name, said in at_bounds(start.estimates).items()
        if name not in found.estimates
    ]


@dataclass(frozen=True)
class Validation:
    """How well drones predict flights."""

    flights: Flights
    log_likelihoods: Mapping[str, float]
    """Mean log likelihood of a row [nats] by drone; more is better."""
    errors: polars.DataFrame
    """As `prediction_error` gives them."""
    notes: tuple[str, ...]


def validate_with(
    drone: StrPath,
    logs: StrPath,
    seed: int,
    output: StrPath,
    horizons: Sequence[float],
    reading: Reading | None = None,
) -> Validation:
    """Predicts flights with a drone and with the paper's Crazyflie.

    Writes the errors to `output` as CSV.

    Beside it, as `NAME_windows.csv`, it writes a few windows row by row. Of more than
    `Reading.most_seconds` of flight, segments are predicted. Commands stand for what they did where
    the drone was identified, unless logs or `reading` say it.
    """
    file = drone_file.read(drone)
    models = {Path(drone).name: file.parameters, "paper's crazyflie": parameters.crazyflie()}
    reading = Reading() if reading is None else reading
    flights = reading.flights(logs)
    known = None if file.source is None else file.source.commands
    if reading.commands is None and known in COMMANDS and all(flight.assumed for flight in flights):
        reading = dataclasses.replace(reading, commands=known, on_file=None)
        flights = reading.flights(logs)
    errors = prediction_error(flights, models, horizons, key=jax.random.key(seed))
    drawn = predicted_windows(flights, models, max(horizons), key=jax.random.key(seed))
    inputs = [drone] if Path(drone).is_file() else []
    settings = {"drone": Path(drone).name, "horizons": list(horizons), **reading.settings}
    made = results.record(seed=seed, inputs=[*inputs, *flights.paths], settings=settings)
    run_folder.VALIDATION.write(output, errors, made)
    run_folder.WINDOWS.write(run_folder.windows_beside(output), drawn, made)
    written: manifest.Files = {
        "validation": [output],
        "windows": [run_folder.windows_beside(output)],
    }
    manifest.append(output, "validate", written, made, {"drone": inputs, "logs": flights.paths})
    likelihoods = {name: log_likelihood(flights.flights, model) for name, model in models.items()}
    notes = [*_not_held_out(file, flights), *_other_law(file, reading)]
    return Validation(flights, likelihoods, errors, (*notes, *at_bounds(file.estimates).values()))


def _not_held_out(drone: DroneFile, flights: Flights) -> list[str]:
    """Says so if a drone was identified from some of the flights, going by its record."""
    used = results.recorded_inputs(drone.record, drone.name)
    seen = sum(results.digest(path) in used for path in flights.paths)
    if seen == 0:
        return []
    return [
        f"{Path(drone.name).name} was identified from {seen} of these {len(flights.paths)} files; "
        "how well it predicts those is no test."
    ]


def _other_law(drone: DroneFile, reading: Reading) -> list[str]:
    """Says so if a drone was identified with another choice of the battery law."""
    settings = drone.record.get("settings", {})
    given = settings.get("battery_law") if isinstance(settings, dict) else None
    if given == reading.battery_law or not drone.source:
        return []
    how = "without --battery-law" if given is None else f"with --battery-law {given!r}"
    return [
        f"{Path(drone.name).name} was identified {how}, unlike here; thrust may differ by that "
        "alone."
    ]
