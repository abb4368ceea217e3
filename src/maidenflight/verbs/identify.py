"""`Identify`: a drone's parameters from flight logs."""

import dataclasses
from collections.abc import Callable, Iterable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import results, run_folder
from maidenflight.errors import InputError
from maidenflight.settings import (
    choice,
    either,
    flag,
    listed,
    number,
    setting,
    table,
    whole,
)
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from maidenflight.flights.log import Flight
    from maidenflight.flights.reading import Flights
    from maidenflight.identification.drone_file import DroneFile
    from maidenflight.identification.methods import Likelihood, Replay
    from maidenflight.identification.outcome.estimates import Identification
    from maidenflight.identification.outcome.progress import Progress as Stage

_PAIR = listed(number(-1e9, 1e9), "LOWER,UPPER", "LOWER,UPPER", count=2)
_BAR_STEPS = 1000


class Identify(Verb):
    """Identify a drone's parameters from LOGS.

    LOGS is a flight log or a folder of them. The likelihood of each row given the row before is
    right for flights under feedback; a replay is the paper's way, many rows open loop.
    """

    output = Output(
        run_folder.DRONE,
        "TOML file for the identified drone; evaluations (identification.csv) and a picture "
        "(identification.svg) go beside it, NAME_identification.csv and .svg beside NAME.toml.",
    )
    fused, steady = True, False

    logs: Path = shared.logs()
    start: str = shared.drone(
        "crazyflie",
        "Drone with the other parameters: a name, of which maidenflight drone --list prints "
        "all, or a TOML file.",
    )
    mass: float | None = shared.mass()
    over: str | tuple[str, ...] | None = setting(
        either(shared.PARAMETERS, "auto"),
        None,
        "Parameters to identify, such as latency,inertia_x, or auto: those that predict flights "
        "held out better.",
        usual="auto; for a replay the paper's three",
        group="Search",
    )
    objective: str = setting(
        choice("likelihood", "replay"),
        "likelihood",
        "likelihood: one row ahead, right for flights under feedback. replay: the paper's, many "
        "rows open loop.",
    )
    evaluations: int = setting(whole(11, 2000), 60, "Most of the objective, a trial.")
    trials: int = setting(whole(1, 100), 2, "Repetitions of the optimiser.")
    bounds: dict[str, tuple[float, float]] = setting(
        table(_PAIR, "NAME=LOWER,UPPER, such as latency=0,0.03", "NAME=LOWER,UPPER"),
        {},
        "Search bounds in SI units; may be repeated.",
        rare=True,
    )
    length: int | None = setting(
        whole(1, 500),
        None,
        "T, rows of a replayed window; 30 by default.",
        rare=True,
    )
    lead_in: int = setting(
        whole(0, 500),
        100,
        "Rows before a window that set its motors; 0: a replay's begin at rest.",
        rare=True,
    )
    method: str | None = setting(
        choice("gradient", "bayesian"),
        None,
        "Optimiser of a replay; gradient by default.",
        rare=True,
    )
    most_seconds: float = shared.most_seconds()
    ignore: tuple[str, ...] = shared.ignore()
    commands: str | None = shared.commands()
    battery_law: str | None = shared.battery_law()
    faulty: str = shared.faulty()
    seed: int = shared.seed()
    verbose: bool = setting(
        flag(),
        False,
        "Also print what was read and dropped, what each signal says by itself, the gains of "
        "groups of parameters, noise and fit.",
        recorded=False,
    )

    def places(self, output: Path) -> list[Path]:
        """Returns the drone's file, the evaluations and the picture."""
        evaluations = run_folder.evaluations_path(output)
        return [output, evaluations, evaluations.with_suffix(".svg")]

    def check_early(self) -> None:
        """Refuses settings of a replay where there is none."""
        for name in ("method", "length"):
            if self.objective != "replay" and getattr(self, name) is not None:
                raise InputError(
                    f"--{name} is of a replay; leave it out, or add --objective replay."
                )

    def check(self) -> None:
        """Refuses a start that is no drone, and unknown parameters."""
        from maidenflight import parameters

        over = [] if isinstance(self.over, str) else self.over or []
        parameters.check_names([*over, *self.bounds])
        _ = self.first

    def compute(self, output: Path, progress: Progress) -> Result:
        """Identifies; writes the drone, every evaluation and a picture."""
        from maidenflight.flights.checkup.result import warning_lines
        from maidenflight.flights.formats import settings as recorder_settings
        from maidenflight.identification.outcome.progress import Overall
        from maidenflight.identification.outcome.progress import Progress as Stage
        from maidenflight.identification.start import note_mass, note_start_at_bounds
        from maidenflight.reporting.figures.identification import (
            identification as identification_figure,
        )
        from maidenflight.reporting.figures.picture import svg
        from maidenflight.verbs.parts import estimates_output, logs_output

        settings, overall = self._objective(), Overall()

        def show(share: float, remark: str) -> None:
            progress.move(int(_BAR_STEPS * share), _BAR_STEPS, remark)

        def on_progress(now: Stage) -> None:
            show(*overall.reach(now))
            if now.unidentifiable:
                left_out = ", ".join(now.unidentifiable)
                progress.note(
                    f"not identifiable from these flights: {left_out}; plausible ranges stay"
                )

        flights = self.read(lambda done, of: show(*overall.read(done, of)), self._compile_early)
        identification = self.identify(flights, self.key, on_progress)
        is_word = isinstance(self.over, str)
        over = self.over if is_word else list(self.over or identification.estimates)
        inputs = [*flights.paths, *shared.own_files(self.start)]
        record = self.make_record(inputs, over=over, **dataclasses.asdict(settings))
        start = float(self.first.parameters.thrust_to_weight)
        notes = [
            *note_mass(self.start, self.mass, flights),
            *logs_output.note_thrust(flights, Path(self.start).name, start),
            *note_start_at_bounds(self.first, identification.estimates),
        ]
        identification = dataclasses.replace(
            identification,
            notes=(*identification.notes, *notes),
            warnings=(*flights.warnings, *identification.warnings),
        )
        identification.write(output, record)
        _, evaluations, picture = self.places(output)
        run_folder.EVALUATIONS.write(evaluations, identification.search)
        figure = identification_figure(identification, self.first.parameters)
        results.write(picture, svg(figure))
        return Result(
            content=_to_content(flights, identification)
            | {"output": str(output), "picture": str(picture)},
            summary=[
                *(self._describe(flights, identification) if self.verbose else []),
                *estimates_output.tabulate_estimates(identification),
                *estimates_output.summarize(identification, recorder_settings(flights.paths)),
            ],
            written={"drone": [output], "evaluations": [evaluations], "picture": [picture]},
            read={"logs": flights.paths},
            record=record,
            rows=[
                {
                    "parameter": name,
                    "value": float(estimate.value),
                    "low": float(estimate.interval[0]),
                    "high": float(estimate.interval[1]),
                }
                for name, estimate in identification.estimates.items()
            ],
            notes=(*warning_lines(identification.warnings), *identification.notes),
            next=("validate", output, "OTHER_LOGS"),
            next_remark="flights that it was not identified from, such as every third, held out",
            value=identification,
        )

    @cached_property
    def first(self) -> "DroneFile":
        """Returns the drone to begin with."""
        from maidenflight.identification.start import read_start

        return read_start(self.start, self.mass)

    def read(
        self,
        on_file: Callable[[int, int], None],
        on_flight: "Callable[[Flight], None] | None" = None,
    ) -> "Flights":
        """Reads the logs.

        Args:
            on_file: called with (files read, files found).
            on_flight: called with each flight.
        """
        from maidenflight.flights.reading import read_flights

        return read_flights(
            *(self.logs, on_file, self.most_seconds, self.lead_in, on_flight),
            commands=self.commands,
            battery_law=self.battery_law,
            ignore=self.ignore,
            faulty=self.faulty,
            drone=self.start,
        )

    def identify(
        self,
        flights: Iterable["Flight"],
        key: Any,
        on_progress: "Callable[[Stage], None]",
    ) -> "Identification":
        """Identifies the drone from flights.

        Args:
            flights: checked flights.
            key: random key.
            on_progress: called with the stage and how far it is.
        """
        from maidenflight.identification.identify import identify

        return identify(
            flights,
            self._objective(),
            start=self.first.parameters,
            over=self.over,
            bounds=self.bounds,
            key=key,
            on_progress=on_progress,
        )

    def _compile_early(self, flight: "Flight") -> None:
        """Has the programs for a flight compiled while others are read."""
        from maidenflight.identification.likelihood.compiling import start_compiling

        if flight.has_state and self.objective == "likelihood":
            start_compiling(flight, self.lead_in)

    def _describe(
        self, flights: "Flights", identification: "Identification"
    ) -> "list[Table | str]":
        from maidenflight.verbs.parts import estimates_output, logs_output

        return [
            *logs_output.describe_flights(flights, f"; {identification.windows} windows of rows"),
            *estimates_output.tabulate_gains(identification),
            *estimates_output.tabulate_evidence(identification),
            *estimates_output.describe_fit(identification, self.start),
            *estimates_output.describe_advice(identification),
        ]

    def _objective(self) -> "Likelihood | Replay":
        from maidenflight.identification.methods import Likelihood, Replay

        common: dict[str, Any] = {
            "lead_in": self.lead_in,
            "evaluations": self.evaluations,
            "trials": self.trials,
        }
        if self.objective == "likelihood":
            return Likelihood(**common)
        own: dict[str, Any] = {"method": self.method, "length": self.length}
        return Replay(**common, **{name: own[name] for name in own if own[name] is not None})


def _to_content(flights: "Flights", identification: "Identification") -> dict[str, Any]:
    from maidenflight.verbs.parts import logs_output

    estimate = ("value", "interval", "trial_mean", "trial_sd", "between_sd", "valley")
    return {
        "parameters": {
            name: {part: getattr(own, part) for part in estimate}
            for name, own in identification.estimates.items()
        },
        "expected": {
            name: dataclasses.asdict(interval) for name, interval in identification.expected.items()
        },
        "unidentified": identification.unidentified,
        "noise": identification.noise,
        "gains": [dataclasses.asdict(gain) for gain in identification.gains],
        "evidence": [estimate._asdict() for estimate in identification.evidence],
        "objective": identification.objective,
        "value": identification.value,
        "windows": identification.windows,
        "evaluations": identification.evaluations,
        "seconds": round(identification.seconds, 3),
        "flights": logs_output.to_content(flights),
        "notes": identification.notes,
    }
