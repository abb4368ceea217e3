"""envelope: how hard a flight may be before policies do not fly it any more."""

from pathlib import Path

import click

from maidenflight import run_folder, terminal
from maidenflight.cli import options
from maidenflight.cli.interruption import resumable
from maidenflight.terminal import flight_output

AXES = ("circle", "figure_eight", "gusts", "payload", "battery", "propeller", "latency")


@click.command()
@click.argument("policies", nargs=-1, required=True, type=options.PATH)
@options.output("Folder for the results.", "envelope")
@click.option(
    "--reality",
    "realities",
    multiple=True,
    help=f"Where: {options.REALITIES}; may be repeated (virtual:7 unless given).",
)
@click.option(
    "--along",
    "axes",
    multiple=True,
    type=click.Choice(AXES),
    help="What grows harder: speed on a circle or a figure-eight, gusts, payload, an emptier "
    "battery, a damaged propeller, latency; may be repeated (circle and figure_eight unless "
    "given). Conditions other than speed are for virtual drones.",
)
@click.option(
    "--flights",
    default=20,
    show_default=True,
    type=click.IntRange(1, 1000),
    help="Flights of each policy along each axis.",
)
@click.option("--resume", is_flag=True, help="Go on with what was interrupted in the folder.")
@options.accept_bounds
@options.seed
@options.as_json
@options.overwrite
def envelope(
    policies: tuple[Path, ...],
    output: Path,
    realities: tuple[str, ...],
    axes: tuple[str, ...],
    flights: int,
    resume: bool,
    accept_bounds: bool,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Find how hard a flight may be before POLICIES do not fly it.

    A flight is flown while its mean distance from the set-point is at most 10 cm and no guard
    trips; the envelope is what 95 % of flights reach. Speed grows within a flight, on a reference
    that gets faster; each grade of another condition is a flight of 20 s of what the policies were
    trained for. raptor and policies by others fly as in transfer. All of it is simulated.
    """
    options.must_be_new(output, overwrite, resume)
    from maidenflight import workflow
    from maidenflight.experiments.envelope import summary

    along = tuple(dict.fromkeys(axes)) or AXES[:2]
    with (
        terminal.progress("envelope", None) as move,
        resumable(output / run_folder.ENVELOPE.name),
    ):
        places = [workflow.reality(name, accept_bounds) for name in realities or ("virtual:7",)]
        files = workflow.policy_files(workflow.own_and_foreign(policies)[0])
        task, notes = workflow.task_to_fly(files, None)
        options.print_notes(notes)
        flown = workflow.envelope_of(
            policies,
            places,
            along,
            seed,
            output,
            flights=flights,
            task=task,
            resume=resume and not overwrite,
            on_axis=move,
        )
    found = summary(flown)
    best = workflow.best_by_envelope(found, files) if files else None

    def text() -> None:
        flight_output.envelope(found)
        if best and len(files) > 1:
            flight_output.best([best], "greatest mean share of all axes")
        print(f"written to {output}/, a row a flight in {run_folder.ENVELOPE.name}, and a picture")

    content = {
        "envelope": found.to_dicts(),
        "best": str(best) if best else None,
        "task": task,
        "notes": notes,
        "simulated": True,
        "output": str(output),
    }
    follows = ("export", best, *workflow.export_options(best)) if best else ()
    options.emit(as_json, content, text, follows)
