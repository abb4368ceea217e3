"""From logs to a drone: record, identify, validate."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import jax
import polars

from maidenflight import parameters, results, run_folder
from maidenflight.flights import log, recording
from maidenflight.flights.reading import COMMANDS, MOST, Flights, read_flights
from maidenflight.identification.estimates import Identification
from maidenflight.identification.identify import identify
from maidenflight.identification.likelihood import Likelihood, log_likelihood
from maidenflight.identification.prediction import predicted_windows, prediction_error
from maidenflight.identification.replay import Replay
from maidenflight.identification.selection import Step
from maidenflight.inputs import StrPath
from maidenflight.simulator.reality import AnyReality
from maidenflight.simulator.virtual_drone import VirtualDrone
from maidenflight.workflow.drones import table


def record(
    drone: AnyReality,
    seed: int,
    folder: StrPath,
    truth: StrPath,
    count: int,
    duration: float,
    excitation: float,
) -> list[Path]:
    """Records flights in a reality: one CSV a flight in `folder`.

    The true parameters of a virtual drone are written to `truth`; other realities have none.
    """
    settings = {
        "reality": drone.name,
        "flights": count,
        "duration": duration,
        "excitation": excitation,
    }
    made = results.record(seed=seed, inputs=[], settings=settings)
    flown = recording.record(drone, jax.random.key(seed), count, duration, excitation)
    if isinstance(drone, VirtualDrone):
        parameters.write(truth, drone.parameters, {"record": made})
    else:
        Path(truth).unlink(missing_ok=True)
    written = [log.write(Path(folder) / f"{flight.name}.csv", flight, made) for flight in flown]
    results.remove_older(written, made)
    return written


@dataclass(frozen=True)
class Reading:
    """How logs are read."""

    most_seconds: float = MOST
    """Flight to use [s]; of more, segments of every flight are."""
    commands: str | None = None
    """What commands stand for where logs do not say it; see `read_flights`."""


def identify_from(
    logs: StrPath,
    seed: int,
    output: StrPath,
    settings: Likelihood | Replay | None = None,
    *,
    start: str = "crazyflie",
    over: Sequence[str] | str | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    reading: Reading | None = None,
    on_file: Callable[[int, int], None] | None = None,
    on_evaluation: Callable[[int, int], None] | None = None,
    on_group: Callable[[Step], None] | None = None,
) -> tuple[Flights, Identification]:
    """Identifies a drone from logs.

    Writes `output` (TOML) and, to `run_folder.beside` it, every evaluation. `settings` is
    `Likelihood()` unless given; the other arguments are as of `identify`.
    """
    settings = Likelihood() if settings is None else settings
    reading = Reading() if reading is None else reading
    flights = read_flights(logs, on_file, reading.most_seconds, settings.lead_in, reading.commands)
    found = identify(
        flights,
        settings,
        start=parameters.read(start),
        over=over,
        bounds=bounds,
        key=jax.random.key(seed),
        on_evaluation=on_evaluation,
        on_group=on_group,
    )
    made = results.record(
        seed=seed,
        inputs=flights.paths,
        settings={
            "start": Path(start).name,
            "over": over if isinstance(over, str) else list(over or found.estimates),
            "objective": found.kind,
            **dataclasses.asdict(settings),
            **dataclasses.asdict(reading),
            "bounds": {name: list(pair) for name, pair in (bounds or {}).items()},
        },
    )
    found.write(output, made)
    run_folder.EVALUATIONS.write(run_folder.beside(output), found.history)
    return flights, found


def validate_with(
    drone: StrPath,
    logs: StrPath,
    seed: int,
    output: StrPath,
    horizons: Sequence[float],
    on_file: Callable[[int, int], None] | None = None,
    commands: str | None = None,
) -> tuple[Flights, polars.DataFrame, list[str]]:
    """Predicts flights with a drone and with the paper's Crazyflie.

    Writes the errors to `output` as CSV.

    Beside it, as `NAME_windows.csv`, it writes a few windows row by row. Of more than `MOST`
    seconds of flight, stretches are predicted. `commands`: see `read_flights`; what the drone was
    identified from unless given.

    Returns:
        The flights, the errors as `prediction_error` gives them, and notes for the user.
    """
    models = {Path(drone).name: parameters.read(drone), "paper's crazyflie": parameters.crazyflie()}
    known = table(drone, "identification").get("commands")
    flights = read_flights(logs, on_file, MOST, commands=commands)
    if commands is None and known in COMMANDS and all(flight.assumed for flight in flights):
        flights = read_flights(logs, None, MOST, commands=known)
    errors = prediction_error(flights, models, horizons, key=jax.random.key(seed))
    drawn = predicted_windows(flights, models, max(horizons), key=jax.random.key(seed))
    inputs = [drone] if Path(drone).is_file() else []
    settings = {"drone": Path(drone).name, "horizons": list(horizons)}
    made = results.record(seed=seed, inputs=[*inputs, *flights.paths], settings=settings)
    run_folder.VALIDATION.write(output, errors, made)
    run_folder.WINDOWS.write(run_folder.windows_beside(output), drawn, made)
    likelihoods = {name: log_likelihood(flights.flights, model) for name, model in models.items()}
    told = ", ".join(f"{name} {value:.2f}" for name, value in likelihoods.items())
    judged = f"log likelihood of a row [nats], of two drones the better one has more: {told}"
    return flights, errors, [judged, *(_not_held_out(drone, flights) if inputs else [])]


def _not_held_out(drone: StrPath, flights: Flights) -> list[str]:
    """Says so if a drone was identified from some of the flights, going by the record in its
    file.
    """
    used = {
        str(entry).rpartition("sha256:")[2] for entry in table(drone, "record").get("inputs", [])
    }
    seen = sum(results.digest(path) in used for path in flights.paths)
    if seen == 0:
        return []
    return [
        f"{Path(drone).name} was identified from {seen} of these {len(flights.paths)} files; how "
        "well it predicts those is no test."
    ]
