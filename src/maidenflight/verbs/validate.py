"""`Validate`: a drone's prediction errors on flights."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from maidenflight import run_folder, terminal
from maidenflight.errors import InputError
from maidenflight.settings import PENDING, REQUIRED, listed, number, setting
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import logs as read
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from polars import DataFrame

    from maidenflight.flights.reading import Flights
    from maidenflight.identification.drone_file import DroneFile


class Validate(Verb):
    """Validate a DRONE on LOGS that it was not identified from.

    DRONE is a TOML file or a name, LOGS a flight log or a folder of them. First stands the log
    likelihood of a row given the row before, the measure to compare drones by. Then, from every
    tenth row, the drone is simulated with the recorded commands alone; the table shows how far it
    is from the flight after some time. Beside it stand the paper's Crazyflie and the persistence
    baseline: position, velocity, attitude and body rates stay as they are.
    """

    output = Output(run_folder.VALIDATION.name, "CSV file for the errors and their intervals.")

    drone: str = shared.drone(REQUIRED, argument=True)
    logs: Path = shared.logs()
    horizons: tuple[float, ...] = setting(
        listed(number(0.001, 60.0), "seconds, such as 0.02,0.05,0.1", "SECONDS"),
        (0.02, 0.05, 0.1),
        "How far ahead to predict [s].",
    )
    commands: str | None = shared.commands()
    battery_law: str | None = shared.battery_law()
    seed: int = shared.seed()

    def places(self, output: Path) -> list[Path]:
        """Returns the table of errors and that of windows."""
        return [output, run_folder.windows_beside(output)]

    def check_early(self) -> None:
        """Refuses logs in a drone's place, and a file that is not there."""
        drone = self.drone
        if drone is PENDING:
            return
        if Path(drone).is_dir() or drone.endswith((".csv", ".csv.gz", ".parquet")):
            raise InputError(
                f"{drone}: not a drone; DRONE comes before LOGS, as in: maidenflight validate "
                f"{self.logs} {drone}."
            )
        shared.must_exist(drone)

    def compute(self, output: Path, progress: Progress) -> Result:
        """Predicts flights with the drone and with the paper's Crazyflie; writes two tables.

        Commands stand for what they did where the drone was identified, unless logs or the setting
        say it.
        """
        import jax

        from maidenflight import parameters
        from maidenflight.flights.reading import COMMANDS, read_flights
        from maidenflight.identification import drone_file
        from maidenflight.identification.likelihood.one_step import log_likelihood
        from maidenflight.identification.outcome.bounds import at_bounds
        from maidenflight.identification.replay.prediction import (
            predicted_windows,
            prediction_error,
        )

        file = drone_file.read(self.drone)
        models = {
            Path(self.drone).name: file.parameters,
            "paper's crazyflie": parameters.crazyflie(),
        }
        law, commands = self.battery_law, self.commands
        flights = read_flights(
            self.logs, read.count_files(progress), commands=commands, battery_law=law
        )
        known = None if file.source is None else file.source.commands
        if commands is None and known in COMMANDS and all(flight.assumed for flight in flights):
            commands = known
            flights = read_flights(self.logs, commands=commands, battery_law=law)
        progress.move(0, None, "compiling and predicting")
        key, horizons = jax.random.key(self.seed), list(self.horizons)
        errors = prediction_error(flights, models, horizons, key=key)
        windows = predicted_windows(flights, models, max(horizons), key=key)
        inputs = [*read.own_files(self.drone), *flights.paths]
        record = self.make_record(inputs, commands=commands)
        places = self.places(output)
        run_folder.VALIDATION.write(places[0], errors, record)
        run_folder.WINDOWS.write(places[1], windows, record)
        likelihoods = {
            name: float(log_likelihood(flights.flights, model)) for name, model in models.items()
        }
        simulated = any(flight.simulated for flight in flights)

        def show() -> None:
            read.show_flights(flights, f"; {errors['windows'][0]} windows of rows")
            _show(likelihoods, errors, simulated)
            print(
                f"written to {output} in SI units, with 95 % intervals over "
                f"{errors['segments'][0]} segments of flight;"
            )
            print(f"some windows row by row, for pictures, to {places[1]}")

        notes = [*_not_held_out(file, flights), *_other_law(file, law)]
        notes += at_bounds(file.estimates).values()
        return Result(
            content={
                "log_likelihoods": likelihoods,
                "errors": errors.to_dicts(),
                "flights": read.to_content(flights),
                "simulated": simulated,
                "notes": notes,
                "output": str(output),
            },
            show=show,
            written={"validation": [places[0]], "windows": [places[1]]},
            read={"drone": read.own_files(self.drone), "logs": flights.paths},
            record=record,
            rows=[
                {**row, "log_likelihood": likelihoods.get(row["model"])}
                for row in errors.to_dicts()
            ],
            notes=notes,
            next=("train", "--drone", self.drone),
            value=errors,
        )


def _not_held_out(drone: "DroneFile", flights: "Flights") -> list[str]:
    """Returns a note if a drone was identified from some of the flights, going by its record."""
    from maidenflight import results

    used = results.recorded_inputs(drone.record, drone.name)
    known = sum(results.digest(path) in used for path in flights.paths)
    if known == 0:
        return []
    return [
        f"{Path(drone.name).name} was identified from {known} of these {len(flights.paths)} files; "
        "how well it predicts those is no test."
    ]


def _other_law(drone: "DroneFile", law: str | None) -> list[str]:
    """Returns a note if a drone was identified with another choice of the battery law."""
    settings = drone.record.get("settings", {})
    given = settings.get("battery_law") if isinstance(settings, dict) else None
    if given == law or not drone.source:
        return []
    how = "without --battery-law" if given is None else f"with --battery-law {given!r}"
    return [
        f"{Path(drone.name).name} was identified {how}, unlike here; thrust may differ by that "
        "alone."
    ]


def _show(likelihoods: Mapping[str, float], errors: "DataFrame", simulated: bool) -> None:
    """Prints likelihoods, and errors, a block of rows for each horizon.

    `*` marks what is worse than the persistence baseline.
    """
    from maidenflight.identification.replay.prediction import PERSISTENCE
    from maidenflight.reporting.text import ERRORS

    terminal.print_table(
        "Likelihood of each row given the rows before, more is better",
        ["drone", "log likelihood\nnats a row"],
        [[name, f"{value:.2f}"] for name, value in likelihoods.items()],
    )
    baseline = {
        row["horizon"]: row for row in errors.iter_rows(named=True) if row["model"] == PERSISTENCE
    }
    rows: list[list[str]] = []
    for row in errors.iter_rows(named=True):
        cells = []
        for name, (_, scale, _) in ERRORS.items():
            worse = not row[name] <= baseline[row["horizon"]][name]
            cells.append(f"{'* ' if worse else ''}{row[name] * scale:#.3g}".removesuffix("."))
        first = row["model"] == errors["model"][0]
        rows.append([f"{row['horizon']:g} s" if first else "", row["model"], *cells])
    columns = ["ahead", "model", *(f"{name}\n{unit}" for name, _, unit in ERRORS.values())]
    title = (
        f"Open-loop prediction errors on {'simulated' if simulated else 'real'} flight, root mean "
        "squares"
    )
    terminal.print_table(title, columns, rows, numbers_from=2)
    if any(cell.startswith("*") for row in rows for cell in row[2:]):
        print(f"* worse than the baseline, {PERSISTENCE}")
