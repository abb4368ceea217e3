"""drone, identify and validate: a drone's parameters, from flight logs and against them."""

import dataclasses
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from maidenflight import run_folder, terminal
from maidenflight.cli import options
from maidenflight.errors import InputError
from maidenflight.terminal import drone_output

if TYPE_CHECKING:
    from maidenflight.flights.reading import Flights
    from maidenflight.identification.estimates import Identification
    from maidenflight.identification.likelihood import Likelihood
    from maidenflight.identification.replay import Replay


@click.command()
@click.argument("name", default="crazyflie")
@options.output("File to write; standard output unless given.")
@options.overwrite
def drone(name: str, output: Path | None, overwrite: bool) -> None:
    """Print a drone's parameters as TOML.

    NAME is a named drone (crazyflie) or a TOML file, which is checked.
    """
    from maidenflight import parameters

    text = parameters.to_toml(parameters.read(name), Path(name).stem)
    if output is None:
        print(text, end="")
        return
    from maidenflight import results

    options.must_be_new(output, overwrite)
    results.write(output, text)


def _bounds(
    _: click.Context, __: click.Parameter, given: tuple[str, ...]
) -> dict[str, tuple[float, float]]:
    pairs = {}
    for entry in given:
        try:
            name, values = entry.split("=")
            low, high = map(float, values.split(","))
        except ValueError as error:
            raise click.BadParameter(
                f"{entry!r}; expected NAME=LOWER,UPPER, such as latency=0,0.03."
            ) from error
        pairs[name] = (low, high)
    return pairs


_commands = click.option(
    "--commands",
    type=click.Choice(["zero-order-hold", "subsampled"]),
    help="What commands stand for in logs that do not say it: each acts until the "
    "next row, as a policy's, or the log is subsampled from the firmware's faster PID, which is "
    "assumed unless given. Taken the wrong way, latency is half a row off.",
)


@click.command()
@click.argument("logs", type=options.PATH)
@options.output(
    "TOML file for the identified drone; identification.csv goes beside it, "
    "NAME_identification.csv beside NAME.toml.",
    run_folder.DRONE,
)
@click.option(
    "--over",
    help="Parameters to identify, such as latency,inertia_x, or auto: those that predict flights "
    "held out better. Unless given, auto;"
    " for a replay the paper's three: thrust_to_weight,motor_time_constant,latency.",
)
@click.option(
    "--objective",
    default="likelihood",
    show_default=True,
    type=click.Choice(["likelihood", "replay"]),
    help="likelihood: one row ahead, right for flights under feedback. replay: the paper's, many "
    "rows open loop.",
)
@click.option(
    "--start",
    default="crazyflie",
    show_default=True,
    help="Drone whose other parameters are kept: a name or a TOML file.",
)
@click.option(
    "--length",
    type=click.IntRange(1, 500),
    help="T, rows of a replayed window; 30 unless given.",
)
@click.option(
    "--history",
    default=100,
    show_default=True,
    type=click.IntRange(1, 500),
    help="Rows before a window that set its motors.",
)
@click.option(
    "--evaluations",
    default=60,
    show_default=True,
    type=click.IntRange(11, 2000),
    help="Most of the objective, a trial.",
)
@click.option(
    "--trials",
    default=2,
    show_default=True,
    type=click.IntRange(1, 100),
    help="Repetitions of the optimiser.",
)
@click.option(
    "--method",
    type=click.Choice(["gradient", "bayesian"]),
    help="Optimiser of a replay; gradient unless given.",
)
@click.option(
    "--bounds",
    multiple=True,
    callback=_bounds,
    help="Search bounds, NAME=LOWER,UPPER in SI units; may be repeated.",
)
@click.option(
    "--most-seconds",
    default=3600.0,
    show_default=True,
    type=options.Range(min=10.0),
    help="Flight to use; of more, segments of every flight are.",
)
@_commands
@options.seed
@options.as_json
@options.overwrite
def identify(
    logs: Path,
    output: Path,
    over: str | None,
    start: str,
    seed: int,
    as_json: bool,
    overwrite: bool,
    bounds: dict[str, tuple[float, float]],
    most_seconds: float,
    commands: str | None,
    **settings: Any,
) -> None:
    """Identify a drone's parameters from LOGS.

    LOGS is a flight log or a folder of them.
    """
    options.must_be_new(output, overwrite)
    from maidenflight import workflow

    options.must_be_new(run_folder.beside(output), overwrite)
    names = (
        over
        if over in (None, "auto")
        else [name.strip() for name in over.split(",") if name.strip()]
    )
    _must_be_known([*(names if isinstance(names, list) else []), *bounds])
    with terminal.progress("identify", None) as move:
        flights, found = workflow.identify_from(
            logs,
            seed,
            output,
            _settings(**settings),
            start=start,
            over=names,
            bounds=bounds,
            reading=workflow.Reading(most_seconds, commands),
            on_file=lambda done, of: (
                move(done, of, "reading flights") if done < of else move(0, None, "compiling")
            ),
            on_evaluation=lambda done, of: move(
                done, of or None, "evaluations" if of else f"{done} evaluations"
            ),
            on_group=lambda gain: move(
                0,
                None,
                f"{gain.group} {'kept' if gain.kept else 'not kept'}: "
                f"{gain.log_likelihood_gain:+.4f} nats a row",
            ),
        )
    options.print_notes(found.notes)

    def text() -> None:
        _print_flights(flights, found.windows)
        drone_output.gains(found)
        drone_output.estimates(found)
        drone_output.kept(found, start)
        drone_output.reached_objective(found, start)
        print(f"written to {output}")

    options.emit(as_json, _identification_content(flights, found) | {"output": str(output)}, text)


def _settings(
    objective: str, method: str | None, length: int | None, history: int, **common: Any
) -> "Likelihood | Replay":
    """Settings of identification from what the command line says."""
    from maidenflight.identification.likelihood import Likelihood
    from maidenflight.identification.replay import Replay

    given = {"method": method, "length": length}
    of_replay: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if objective == "replay":
        return Replay(lead_in=history, **of_replay, **common)
    if of_replay:
        raise InputError(
            f"--{next(iter(of_replay))} is of a replay; leave it out, or add --objective replay."
        )
    return Likelihood(lead_in=history, **common)


def _must_be_known(names: Iterable[str]) -> None:
    """Refuses what is no parameter, with those that may be meant: the whole list is long."""
    from difflib import get_close_matches

    from maidenflight.parameters import COMPONENTS

    for name in names:
        if name not in COMPONENTS:
            alike = [
                *(known for known in COMPONENTS if name and name in known),
                *get_close_matches(name, COMPONENTS, 3),
            ]
            meant = f" Did you mean {' or '.join(dict.fromkeys(alike[:3]))}?" if alike else ""
            raise InputError(
                f"unknown parameter {name!r}.{meant} All are in what this prints: maidenflight "
                "drone crazyflie."
            )


def _identification_content(flights: "Flights", found: "Identification") -> dict[str, Any]:
    return {
        "parameters": {
            name: {
                "value": estimate.value,
                "interval": list(estimate.interval),
                "trial_mean": estimate.trial_mean,
                "trial_sd": estimate.trial_sd,
                "between_segment_sd": estimate.between_segment_sd,
                "valley": estimate.valley,
            }
            for name, estimate in found.estimates.items()
        },
        "noise": found.noise,
        "gains": [dataclasses.asdict(gain) for gain in found.gains],
        "objective": found.objective,
        "value": found.value,
        "windows": found.windows,
        "evaluations": found.evaluations,
        "seconds": round(found.seconds, 3),
        "flights": _flights_content(flights),
        "notes": found.notes,
    }


def _times(_: click.Context, __: click.Parameter, given: str) -> list[float]:
    try:
        return [float(entry) for entry in given.split(",")]
    except ValueError as error:
        raise click.BadParameter(f"{given!r}; expected seconds, such as 0.1,0.25,0.5.") from error


@click.command()
@click.argument("drone_", metavar="DRONE")
@click.argument("logs", type=options.PATH)
@options.output("CSV file for the errors and their intervals.", run_folder.VALIDATION.name)
@click.option(
    "--horizons",
    default="0.1,0.25,0.5",
    show_default=True,
    callback=_times,
    help="How far ahead to predict, seconds.",
)
@_commands
@options.seed
@options.as_json
@options.overwrite
def validate(
    drone_: str,
    logs: Path,
    output: Path,
    horizons: list[float],
    commands: str | None,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Validate a DRONE on LOGS that it was not identified from.

    DRONE is a TOML file or a name, LOGS a flight log or a folder of them. From every tenth row the
    drone is simulated with the recorded commands alone; the table shows how far it is from the
    flight then. Beside it stand the paper's Crazyflie and the persistence baseline:
    position, velocity, attitude and body rates stay as they are.
    """
    _must_be_a_drone(drone_, logs)
    windows = output.with_name(f"{output.stem}_windows.csv")
    options.must_be_new(output, overwrite)
    options.must_be_new(windows, overwrite)
    from maidenflight import workflow

    with terminal.progress("validate", None) as move:
        flights, errors, notes = workflow.validate_with(
            drone_,
            logs,
            seed,
            output,
            horizons,
            lambda done, of: (
                move(done, of, "reading flights")
                if done < of
                else move(0, None, "compiling and predicting")
            ),
            commands,
        )
    options.print_notes(notes)
    simulated = any(flight.simulated for flight in flights)
    content = {
        "errors": errors.to_dicts(),
        "flights": _flights_content(flights),
        "simulated": simulated,
        "notes": notes,
        "output": str(output),
    }

    def text() -> None:
        _print_flights(flights, errors["windows"][0])
        drone_output.predictions(errors, simulated=simulated)
        print(
            f"written to {output} in SI units, with 95 % intervals over {errors['segments'][0]} "
            "segments of flight;"
        )
        print(f"some windows row by row, for pictures, to {windows}")

    options.emit(as_json, content, text)


def _must_be_a_drone(given: str, logs: Path) -> None:
    """Refuses logs in a drone's place, and a file that is not there."""
    if Path(given).is_dir() or given.endswith((".csv", ".csv.gz", ".parquet")):
        raise InputError(
            f"{given}: not a drone; DRONE comes before LOGS, as in: maidenflight validate {logs} "
            f"{given}."
        )
    options.must_exist(given)


def _flights_content(flights: "Flights") -> dict[str, Any]:
    return {
        "files": len(flights.paths),
        "pieces": len(flights),
        "seconds": round(flights.duration, 2),
        "dropped": flights.notes,
        "refused": flights.refused,
    }


def _print_flights(flights: "Flights", windows: int) -> None:
    print(
        f"{len(flights.paths)} files, {len(flights)} usable pieces of flight, "
        f"{flights.duration:.0f} s; {windows} windows of rows"
    )
    if flights.notes:
        terminal.notes(flights.notes)
    if flights.refused:
        print(f"{len(flights.refused)} files refused:", file=sys.stderr)
        for reason in flights.refused[:3]:
            print(f"  {reason}", file=sys.stderr)
        if len(flights.refused) > 3:
            print(f"  and {len(flights.refused) - 3} more; --json lists them all", file=sys.stderr)
