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
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import DroneFile, GroupGain
from maidenflight.identification.estimates import Identification
from maidenflight.identification.identify import identify
from maidenflight.identification.likelihood import Likelihood, log_likelihood
from maidenflight.identification.prediction import predicted_windows, prediction_error
from maidenflight.identification.replay import Replay
from maidenflight.inputs import StrPath
from maidenflight.simulator.reality import AnyReality
from maidenflight.simulator.virtual_drone import VirtualDrone


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
        DroneFile(drone.parameters, record=made).write(truth)
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
    on_group: Callable[[GroupGain], None] | None = None,
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
            "objective": found.objective,
            **dataclasses.asdict(settings),
            **dataclasses.asdict(reading),
            "bounds": {name: list(pair) for name, pair in (bounds or {}).items()},
        },
    )
    found.write(output, made)
    run_folder.EVALUATIONS.write(run_folder.beside(output), found.search)
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
    seconds of flight, segments are predicted. `commands`: see `read_flights`; what the drone was
    identified from unless given.

    Returns:
        The flights, the errors as `prediction_error` gives them, and notes for the user.
    """
    file = drone_file.read(drone)
    models = {Path(drone).name: file.parameters, "paper's crazyflie": parameters.crazyflie()}
    flights = read_flights(logs, on_file, MOST, commands=commands)
    known = None if file.source is None else file.source.commands
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
    compared = ", ".join(f"{name} {value:.2f}" for name, value in likelihoods.items())
    judged = f"log likelihood of a row [nats], more is better: {compared}"
    return flights, errors, [judged, *_not_held_out(file, flights)]


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
