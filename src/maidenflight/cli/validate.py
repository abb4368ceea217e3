"""The command validate: a drone's prediction errors on flights."""

from pathlib import Path

import click

from maidenflight import run_folder, terminal
from maidenflight.cli import options
from maidenflight.errors import InputError
from maidenflight.terminal import drone_output, log_output


def _times(_: click.Context, __: click.Parameter, given: str) -> list[float]:
    try:
        return [float(entry) for entry in given.split(",")]
    except ValueError as error:
        raise click.BadParameter(f"{given!r}; expected seconds, such as 0.02,0.05,0.1.") from error


@click.command()
@click.argument("drone_", metavar="DRONE")
@click.argument("logs", type=options.PATH)
@options.output("CSV file for the errors and their intervals.", run_folder.VALIDATION.name)
@click.option(
    "--horizons",
    default="0.02,0.05,0.1",
    show_default=True,
    callback=_times,
    help="How far ahead to predict, seconds.",
)
@options.commands
@options.battery_law
@options.seed
@options.as_json
@options.overwrite
def validate(
    drone_: str,
    logs: Path,
    output: Path,
    horizons: list[float],
    commands: str | None,
    battery_law: str | None,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Validate a DRONE on LOGS that it was not identified from.

    DRONE is a TOML file or a name, LOGS a flight log or a folder of them. First stands the log
    likelihood of a row given the row before, the measure to compare drones by. Then, from every
    tenth row, the drone is simulated with the recorded commands alone; the table shows how far it
    is from the flight after some time. Beside it stand the paper's Crazyflie and the persistence
    baseline: position, velocity, attitude and body rates stay as they are.
    """
    _must_be_a_drone(drone_, logs)
    windows = output.with_name(f"{output.stem}_windows.csv")
    options.must_be_new(output, overwrite)
    options.must_be_new(windows, overwrite)
    from maidenflight import workflow

    with terminal.progress("validate", None) as move:
        found = workflow.validate_with(
            drone_,
            logs,
            seed,
            output,
            horizons,
            workflow.Reading(
                commands=commands,
                battery_law=battery_law,
                on_file=lambda done, of: (
                    move(done, of, "reading flights")
                    if done < of
                    else move(0, None, "compiling and predicting")
                ),
            ),
        )
    flights, errors = found.flights, found.errors
    options.print_notes(found.notes)
    simulated = any(flight.simulated for flight in flights)
    content = {
        "log_likelihoods": dict(found.log_likelihoods),
        "errors": errors.to_dicts(),
        "flights": log_output.content(flights),
        "simulated": simulated,
        "notes": found.notes,
        "output": str(output),
    }

    def text() -> None:
        log_output.show(flights, errors["windows"][0])
        drone_output.log_likelihoods(found.log_likelihoods)
        drone_output.predictions(errors, simulated=simulated)
        print(
            f"written to {output} in SI units, with 95 % intervals over {errors['segments'][0]} "
            "segments of flight;"
        )
        print(f"some windows row by row, for pictures, to {windows}")

    options.emit(as_json, content, text, ("train", "--drone", drone_))


def _must_be_a_drone(given: str, logs: Path) -> None:
    """Refuses logs in a drone's place, and a file that is not there."""
    if Path(given).is_dir() or given.endswith((".csv", ".csv.gz", ".parquet")):
        raise InputError(
            f"{given}: not a drone; DRONE comes before LOGS, as in: maidenflight validate {logs} "
            f"{given}."
        )
    options.must_exist(given)
