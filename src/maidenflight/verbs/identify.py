"""`Identify`: a drone's parameters from flight logs."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import names, run_folder
from maidenflight.errors import InputError
from maidenflight.settings import choice, either, listed, number, setting, several, table, whole
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import logs as read
from maidenflight.verbs import shared
from maidenflight.verbs.estimates_output import (
    show_estimates,
    show_fit,
    show_gains,
    show_unidentifiable,
)

if TYPE_CHECKING:
    from maidenflight.flights.reading import Flights
    from maidenflight.identification.drone_file import DroneFile
    from maidenflight.identification.methods import Likelihood, Replay
    from maidenflight.identification.outcome.estimates import Identification
    from maidenflight.identification.outcome.progress import Progress as Stage

_SEARCH = "Search"
_PAIR = dataclasses.replace(
    listed(number(-1e9, 1e9), "LOWER,UPPER", "LOWER,UPPER"),
    accepts=lambda pair: (
        isinstance(pair, list | tuple)
        and len(pair) == 2
        and all(map(number(-1e9, 1e9).accepts, pair))
    ),
)
SHARES = {
    "reading flights": 1.0,
    "motor lag": 4.0,
    "what flights can tell": 2.0,
    "choosing parameters": 8.0,
    "fitting": 5.0,
    "intervals": 2.0,
}
"""How long each stage takes beside the others: four minutes of flight with an accelerometer."""
_COUNTED = {"motor lag": "flights", "choosing parameters": "groups"}
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
        "Drone whose other parameters are kept: a name, of which maidenflight drone --list prints "
        "all, or a TOML file.",
    )
    mass: float | None = shared.mass()
    over: str | tuple[str, ...] | None = setting(
        either(shared.PARAMETERS, "auto"),
        None,
        "Parameters to identify, such as latency,inertia_x, or auto: those that predict flights "
        "held out better.",
        usual="auto; for a replay the paper's three",
        group=_SEARCH,
    )
    objective: str = setting(
        choice("likelihood", "replay"),
        "likelihood",
        "likelihood: one row ahead, right for flights under feedback. replay: the paper's, many "
        "rows open loop.",
        group=_SEARCH,
    )
    evaluations: int = setting(
        whole(11, 2000), 60, "Most of the objective, a trial.", group=_SEARCH
    )
    trials: int = setting(whole(1, 100), 2, "Repetitions of the optimiser.", group=_SEARCH)
    bounds: dict[str, tuple[float, float]] = setting(
        table(_PAIR, "NAME=LOWER,UPPER, such as latency=0,0.03", "NAME=LOWER,UPPER"),
        {},
        "Search bounds in SI units; may be repeated.",
        group=_SEARCH,
        rare=True,
    )
    length: int | None = setting(
        whole(1, 500),
        None,
        "T, rows of a replayed window; 30 unless given.",
        group=_SEARCH,
        rare=True,
    )
    lead_in: int = setting(
        whole(1, 500), 100, "Rows before a window that set its motors.", group=_SEARCH, rare=True
    )
    method: str | None = setting(
        choice("gradient", "bayesian"),
        None,
        "Optimiser of a replay; gradient unless given.",
        group=_SEARCH,
        rare=True,
    )
    most_seconds: float = shared.most_seconds()
    ignore: tuple[str, ...] = setting(
        several(choice(*names.OPTIONAL_SIGNALS), empty=True),
        (),
        "Signal to pass over as if it had not been logged, to judge what is found without it; may "
        "be repeated.",
        group=shared.LOGS,
        rare=True,
    )
    commands: str | None = shared.commands()
    battery_law: str | None = shared.battery_law()
    seed: int = shared.seed()

    def places(self, output: Path) -> list[Path]:
        """Returns the drone's file, the evaluations and the picture."""
        return [output, run_folder.beside(output), run_folder.picture_beside(output)]

    def check_early(self) -> None:
        """Refuses settings of a replay where there is none."""
        for name in ("method", "length"):
            if self.objective != "replay" and getattr(self, name) is not None:
                raise InputError(
                    f"--{name} is of a replay; leave it out, or add --objective replay."
                )

    def check(self) -> None:
        """Refuses a start that is no drone, and unknown parameters."""
        over = [] if isinstance(self.over, str) else self.over or []
        _must_be_known([*over, *self.bounds])
        read.read_start(self.start, self.mass)

    def compute(self, output: Path, progress: Progress) -> Result:
        """Identifies; writes the drone, every evaluation and a picture."""
        import jax

        from maidenflight import results
        from maidenflight.flights.reading import read_flights
        from maidenflight.identification.identify import identify
        from maidenflight.reporting.identification_picture import identification_picture

        settings, start = self._objective(), read.read_start(self.start, self.mass)
        stages = _Stages(progress)
        flights = read_flights(
            *(self.logs, stages.on_file, self.most_seconds, settings.lead_in),
            *(self.commands, self.battery_law, self.ignore),
        )
        found = identify(
            flights,
            settings,
            start=start.parameters,
            over=self.over,
            bounds=self.bounds,
            key=jax.random.key(self.seed),
            on_progress=stages.on_progress,
        )
        over = self.over if isinstance(self.over, str) else list(self.over or found.estimates)
        record = self.make_record(
            [*flights.paths, *read.own_files(self.start)],
            over=over,
            **dataclasses.asdict(settings),
        )
        notes = [*read.note_mass(self.start, self.mass, flights), *_kept_at_bounds(start, found)]
        found = dataclasses.replace(found, notes=(*found.notes, *notes))
        found.write(output, record)
        run_folder.EVALUATIONS.write(run_folder.beside(output), found.search)
        picture = run_folder.picture_beside(output)
        results.write(picture, identification_picture(found, start.parameters))
        return Result(
            content=_to_content(flights, found) | {"output": str(output), "picture": str(picture)},
            show=lambda: self._show(flights, found, output, picture),
            written={
                "drone": [output],
                "evaluations": [run_folder.beside(output)],
                "picture": [picture],
            },
            read={"logs": flights.paths},
            record=record,
            rows=[
                {
                    "parameter": name,
                    "value": float(one.value),
                    "low": float(one.interval[0]),
                    "high": float(one.interval[1]),
                }
                for name, one in found.estimates.items()
            ],
            notes=found.notes,
            next=("validate", output, "OTHER_LOGS"),
            next_remark="flights that it was not identified from",
            value=found,
        )

    def _objective(self) -> "Likelihood | Replay":
        from maidenflight.identification.methods import Likelihood, Replay

        common: dict[str, Any] = {
            "lead_in": self.lead_in,
            "evaluations": self.evaluations,
            "trials": self.trials,
        }
        given: dict[str, Any] = {"method": self.method, "length": self.length}
        given = {name: value for name, value in given.items() if value is not None}
        return Replay(**given, **common) if self.objective == "replay" else Likelihood(**common)

    def _show(
        self, flights: "Flights", found: "Identification", output: Path, picture: Path
    ) -> None:
        read.show_flights(flights, f"; {found.windows} windows of rows")
        show_gains(found)
        show_estimates(found)
        show_unidentifiable(found)
        show_fit(found, self.start)
        print(f"written to {output}; a picture of it: {picture}")


class _Stages:
    """Shows how far an identification is, on a bar that never moves back."""

    def __init__(self, progress: Progress) -> None:
        self._progress, self._reached = progress, 0.0

    def on_file(self, done: int, of: int) -> None:
        """Shows how many files are read."""
        first = next(iter(SHARES))
        self._move(first, done, of, f"{first}, {done} of {of}")

    def on_progress(self, now: "Stage") -> None:
        """Shows the stage; says before anything is fitted what the flights do not determine."""
        self._move(now.stage, now.done, now.of, describe_stage(now))
        names = [name for name, one in (now.expected or {}).items() if not one.identifiable]
        if names:
            self._progress.note(
                f"these flights cannot tell {', '.join(names)}; plausible ranges are kept"
            )

    def _move(self, stage: str, done: int, of: int, remark: str) -> None:
        before = sum(SHARES[name] for name in list(SHARES)[: list(SHARES).index(stage)])
        within = SHARES[stage] * min(done / of, 1.0) if of else 0.0
        self._reached = max(self._reached, (before + within) / sum(SHARES.values()))
        self._progress.move(int(_BAR_STEPS * self._reached), _BAR_STEPS, remark)


def describe_stage(now: "Stage") -> str:
    """Returns a stage of an identification in words."""
    parts = [now.stage]
    if now.of and now.stage in _COUNTED:
        parts.append(f"{now.done} of {now.of} {_COUNTED[now.stage]}")
    if now.gain is not None:
        parts.append(f"{now.gain.group} {'kept' if now.gain.kept else 'not kept'}")
    if now.evaluations:
        parts.append(f"evaluation {now.evaluations}")
    return ", ".join(parts)


def _must_be_known(given: Iterable[str]) -> None:
    """Refuses what is no parameter, with those that may be meant: the whole list is long."""
    from difflib import get_close_matches

    from maidenflight.parameters import COMPONENTS

    for name in given:
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


def _kept_at_bounds(start: "DroneFile", found: "Identification") -> list[str]:
    """Returns what was kept of a start although it lay at a search bound there."""
    from maidenflight.identification.outcome.bounds import at_bounds

    return [
        f"kept from {Path(start.name).name}: {text}"
        for name, text in at_bounds(start.estimates).items()
        if name not in found.estimates
    ]


def _to_content(flights: "Flights", found: "Identification") -> dict[str, Any]:
    estimate = ("value", "interval", "trial_mean", "trial_sd", "between_sd", "valley")
    return {
        "parameters": {
            name: {part: getattr(one, part) for part in estimate}
            for name, one in found.estimates.items()
        },
        "expected": {name: dataclasses.asdict(one) for name, one in found.expected.items()},
        "unidentified": found.unidentified,
        "noise": found.noise,
        "gains": [dataclasses.asdict(gain) for gain in found.gains],
        "objective": found.objective,
        "value": found.value,
        "windows": found.windows,
        "evaluations": found.evaluations,
        "seconds": round(found.seconds, 3),
        "flights": read.to_content(flights),
        "notes": found.notes,
    }
