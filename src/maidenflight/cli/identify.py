"""The command identify: a drone's parameters from flight logs."""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from maidenflight import compiler, cores, run_folder
from maidenflight.cli import options
from maidenflight.errors import InputError
from maidenflight.terminal import drone_output, log_output, progress_output

CLOSED_LOOP = "closed_loop"

if TYPE_CHECKING:
    from maidenflight.flights.reading import Flights
    from maidenflight.identification.estimates import Identification
    from maidenflight.identification.information import Expected
    from maidenflight.identification.likelihood import Likelihood
    from maidenflight.identification.replay import Replay
    from maidenflight.workflow import Reading, Start


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


@click.command()
@click.argument("logs", type=options.PATH)
@click.argument("policies", nargs=-1, type=options.PATH)
@options.output(
    "TOML file for the identified drone; evaluations (identification.csv) and a picture "
    "(identification.svg) go beside it, NAME_identification.csv and .svg beside NAME.toml.",
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
    type=click.Choice(["likelihood", "replay", "closed_loop"]),
    help="likelihood: one row ahead, right for flights under feedback. replay: the paper's, many "
    "rows open loop. closed_loop: POLICIES that flew the logs behave in simulation as they did "
    "there; from the drone of --start, identified by likelihood before.",
)
@click.option(
    "--start",
    default="crazyflie",
    show_default=True,
    help="Drone whose other parameters are kept: a name, of which maidenflight drone --list prints "
    "all, or a TOML file.",
)
@options.mass
@click.option(
    "--length",
    type=click.IntRange(1, 500),
    help="T, rows of a replayed window; 30 unless given.",
)
@click.option(
    "--lead-in",
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
@click.option(
    "--ignore",
    multiple=True,
    type=click.Choice(["accelerometer", "rotor_speed"]),
    help="Signal to pass over as if it had not been logged, to judge what is found without it; may "
    "be repeated.",
)
@options.commands
@options.battery_law
@options.seed
@options.as_json
@options.overwrite
@click.pass_context
def identify(
    context: click.Context,
    logs: Path,
    policies: tuple[Path, ...],
    output: Path,
    over: str | None,
    start: str,
    mass: float | None,
    seed: int,
    as_json: bool,
    overwrite: bool,
    bounds: dict[str, tuple[float, float]],
    most_seconds: float,
    ignore: tuple[str, ...],
    commands: str | None,
    battery_law: str | None,
    **settings: Any,
) -> None:
    """Identify a drone's parameters from LOGS.

    LOGS is a flight log or a folder of them. POLICIES, for --objective closed_loop, are files or
    folders of the policies that flew them.
    """
    options.must_be_new(output, overwrite)
    if settings["objective"] != CLOSED_LOOP:
        compiler.set_flags(compiler.FUSED)
    from maidenflight import workflow

    begin = workflow.Start(start, None if mass is None else mass / 1e3)
    if settings["objective"] == CLOSED_LOOP:
        _only_of_the_loop(context, policies)
        read = workflow.Reading(most_seconds, commands, battery_law, ignore)
        _match(logs, policies, seed, output, begin, read, as_json)
        return
    if policies:
        raise click.UsageError(
            f"{policies[0]}: policies are for --objective {CLOSED_LOOP}. Leave them out, or add it."
        )

    options.must_be_new(run_folder.beside(output), overwrite)
    picture = run_folder.picture_beside(output)
    options.must_be_new(picture, overwrite)
    names = (
        over
        if over in (None, "auto")
        else [name.strip() for name in over.split(",") if name.strip()]
    )
    _must_be_known([*(names if isinstance(names, list) else []), *bounds])
    with progress_output.identification(_say_untold) as (on_file, on_progress):
        flights, found = workflow.identify_from(
            logs,
            seed,
            output,
            _settings(**settings),
            start=begin,
            over=names,
            bounds=bounds,
            reading=workflow.Reading(most_seconds, commands, battery_law, ignore, on_file),
            on_progress=on_progress,
        )
    options.print_notes(found.notes)

    def text() -> None:
        log_output.show(flights, found.windows)
        drone_output.gains(found)
        drone_output.estimates(found)
        drone_output.untold(found)
        drone_output.kept(found, start)
        drone_output.reached_objective(found, start)
        print(f"written to {output}; a picture of it: {picture}")

    written = {"output": str(output), "picture": str(picture)}
    options.emit(
        as_json,
        _identification_content(flights, found) | written,
        text,
        ("validate", output, "OTHER_LOGS"),
        "flights that it was not identified from",
    )


_OF_THE_LOOP = {
    *("logs", "policies", "output", "objective", "start", "mass", "most_seconds", "commands"),
    *("battery_law", "ignore", "seed", "as_json", "overwrite"),
}
"""Parameters of the command that mean anything for the closed loop."""


def _only_of_the_loop(context: click.Context, policies: tuple[Path, ...]) -> None:
    """Refuses options that mean nothing for the closed loop.

    Raises:
        click.UsageError: one is given, or no policies.
    """
    if not policies:
        raise click.UsageError(f"--objective {CLOSED_LOOP}: give the POLICIES that flew the logs.")
    for name, option in options.given(context).items():
        if name not in _OF_THE_LOOP:
            raise click.UsageError(
                f"{option} means nothing for --objective {CLOSED_LOOP}. Leave it out."
            )


def _match(
    logs: Path,
    policies: tuple[Path, ...],
    seed: int,
    output: Path,
    start: "Start",
    reading: "Reading",
    as_json: bool,
) -> None:
    """Identifies in the closed loop, and says what was found."""
    cores.as_devices()
    from maidenflight import terminal, workflow
    from maidenflight.identification.behaviour import BEHAVIOUR

    with terminal.progress("identify", None) as move:
        move(0, None, "compiling")
        flights, found = workflow.match_loops(
            logs,
            policies,
            seed,
            output,
            start=start,
            reading=reading,
            on_step=lambda done, of, cost: move(done, of, f"difference {cost:.3g}"),
        )
    content = {
        "parameters": {
            name: {"value": value, "standard_error": error}
            for name, (value, error) in found.found.items()
        },
        "behaviour": {
            name: {"before": round(float(before), 4), "after": round(float(after), 4)}
            for name, before, after in zip(BEHAVIOUR, found.before, found.after, strict=True)
        },
        "objective": CLOSED_LOOP,
        "policies": found.policies,
        "compared": found.flights,
        "evaluations": found.evaluations,
        "flights": log_output.content(flights),
        "output": str(output),
    }

    def text() -> None:
        drone_output.matched(found, len(flights))
        print(f"written to {output}")

    options.emit(as_json, content, text, ("predict", "POLICIES", "--drone", output))


def _say_untold(expected: "Mapping[str, Expected]") -> None:
    """Says before anything is fitted what the flights will not tell."""
    names = [name for name, one in expected.items() if not one.identifiable]
    if names:
        options.print_notes(
            [f"these flights cannot tell {', '.join(names)}; plausible ranges are kept"]
        )


def _settings(
    objective: str, method: str | None, length: int | None, **common: Any
) -> "Likelihood | Replay":
    """Settings of identification from what the command line says."""
    from maidenflight.identification.likelihood import Likelihood
    from maidenflight.identification.replay import Replay

    given = {"method": method, "length": length}
    of_replay: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if objective == "replay":
        return Replay(**of_replay, **common)
    if of_replay:
        raise InputError(
            f"--{next(iter(of_replay))} is of a replay; leave it out, or add --objective replay."
        )
    return Likelihood(**common)


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
                "between_sd": estimate.between_sd,
                "valley": estimate.valley,
            }
            for name, estimate in found.estimates.items()
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
        "flights": log_output.content(flights),
        "notes": found.notes,
    }
