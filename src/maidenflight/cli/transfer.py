"""transfer and predict: policies in unseen realities, and on the identified drone."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from maidenflight import compiler, cores, run_folder, terminal
from maidenflight.cli import options
from maidenflight.cli.interruption import resumable
from maidenflight.terminal import flight_output

if TYPE_CHECKING:
    from polars import DataFrame

    from maidenflight.studies.status import Progress


@click.command()
@click.argument("policies", nargs=-1, type=options.PATH)
@options.output("Folder for the flights.", run_folder.TRANSFER)
@click.option(
    "--reality",
    "realities",
    multiple=True,
    help=f"Where: {options.REALITIES}, or from 5 s on as +yaw6000@5, +weak10@5, +payload15@5; may "
    "be repeated (virtual:7 unless given, about --drone).",
)
@click.option(
    "--drone",
    "drone_",
    metavar="DRONE",
    help="Your drone, a TOML file or a name: policies fly virtual:7@DRONE unless --reality says.",
)
@click.option(
    "--task",
    type=click.Choice(options.TASKS),
    help="What they fly (what they were trained for unless given).",
)
@click.option(
    "--trials",
    type=click.IntRange(1, 1000),
    help="Flights of each policy in each reality (3 unless given).",
)
@click.option(
    "--duration", type=options.Range(0.1, 600.0), help="Longest flight, seconds (20 unless given)."
)
@click.option(
    "--matrix",
    "settings",
    type=options.PATH,
    help="Train policies for many drones first and fly those: a TOML file such as "
    "paper/zero_shot.toml, which says all the rest.",
)
@click.option(
    "--on",
    help="Where the policies of a matrix are trained, as of sweep: local, ray, ray:ADDRESS, slurm "
    "or slurm:PARTITION; a cell after the other in this process unless given.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Go on with a matrix that was interrupted in the folder, with the same result.",
)
@click.option(
    "--seed", type=int, help="Random seed; the same seed gives the same results (0 unless given)."
)
@options.accept_bounds
@options.as_json
@options.overwrite
def transfer(
    policies: tuple[Path, ...],
    output: Path,
    realities: tuple[str, ...],
    drone_: str | None,
    task: str | None,
    trials: int | None,
    duration: float | None,
    settings: Path | None,
    on: str | None,
    resume: bool,
    seed: int | None,
    accept_bounds: bool,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Fly POLICIES in simulated realities that they have not seen.

    POLICIES are files or folders, or with --matrix those of a matrix. They are ours, or the
    authors' in files whose names begin with a control structure; all of one call are of one kind.
    Beside them fly raptor, raptor:500hz, pid and mellinger of the firmware, networks in ONNX or of
    Stable-Baselines3 that a TOML file describes, and .zip files of the latter that
    maidenflight.gym trained.
    """
    if settings is not None:
        if (
            policies
            or realities
            or any(given is not None for given in (drone_, task, trials, duration, seed))
        ):
            raise click.UsageError(
                f"{settings} says which policies fly, where and how. Give --matrix alone, with -o."
            )
        _transfer_matrix(settings, output, on, resume, overwrite, as_json, accept_bounds)
        return
    if not policies or resume or on:
        raise click.UsageError(
            "Only a matrix is resumed, or trained on other machines."
            if policies
            else "Give policies (files or folders), or --matrix."
        )
    options.must_be_new(output, overwrite)
    from maidenflight import workflow

    with terminal.progress("transfer", None) as move:
        asked = realities or (f"virtual:7@{drone_}" if drone_ else "virtual:7",)
        places = [workflow.reality(name, accept_bounds) for name in asked]
        files = workflow.policy_files(workflow.own_and_foreign(policies)[0])
        task, notes = workflow.task_to_fly(files, task)
        options.print_notes(notes)
        move(0, None, "compiling and flying")
        flown = workflow.transfer_to(
            policies, places, seed or 0, output, trials or 3, duration or 20.0, task
        )
    summary = workflow.transfer_summary(flown)
    best = workflow.best_policy(flown, files) if files else None
    cycles = workflow.limit_cycles(summary)
    options.print_notes(cycles)
    content = {
        "flights": flown.table.to_dicts(),
        "summary": summary.to_dicts(),
        "best": str(best) if best else None,
        "task": task,
        "notes": [*notes, *cycles],
        "simulated": True,
        "output": str(output),
    }

    def text() -> None:
        if flown.table.height <= flight_output.FEW:
            flight_output.flights(flown)
        flight_output.by_policy(summary)
        if best and len(files) > 1:
            flight_output.best(
                [best],
                "longest mean flight; among equals no limit cycle and the smallest mean error",
            )
        print(f"written to {output}/, a row a flight in flights.csv")

    follows = ("export", best, *workflow.export_options(best)) if best else ()
    options.emit(as_json, content, text, follows)


def _transfer_matrix(
    settings: Path,
    output: Path,
    on: str | None,
    resume: bool,
    overwrite: bool,
    as_json: bool,
    accept_bounds: bool,
) -> None:
    options.must_be_new(output, overwrite, resume)
    compiler.prepare_jax(fused=True)
    from maidenflight import workflow
    from maidenflight.experiments import matrix, matrix_file

    asked = matrix_file.read(settings)
    with (
        terminal.progress("transfer", len(asked.rows)) as move,
        resumable(output / run_folder.POLICIES if on is None else output),
    ):
        if on is not None:
            from maidenflight.studies import rows

            def hear(now: "Progress") -> None:
                move(now.done, now.tasks, f"training rows, {len(now.running)} at once")

            if overwrite and not resume:
                rows.forget(output)
            rows.train_rows(
                settings, asked, output, on, accept_bounds=accept_bounds, on_progress=hear
            )
        flights = workflow.transfer_matrix(
            asked,
            output,
            move,
            restart=overwrite and not resume and on is None,
            accept_bounds=accept_bounds,
        )
    cells = matrix.by_cell(flights, asked.duration)

    def text() -> None:
        flight_output.cells(cells)
        print(
            f"{flights.height} simulated flights of {len(asked.cells) * asked.policies} policies, "
            f"written to {output}/flights.csv"
        )

    options.emit(
        as_json,
        {
            "flights": flights.to_dicts(),
            "cells": cells.to_dicts(),
            "simulated": True,
            "output": str(output),
        },
        text,
        ("report", output),
    )


@click.command()
@click.argument("policies", nargs=-1, required=True, type=options.PATH)
@click.option(
    "--drone",
    "drone_",
    default=run_folder.DRONE,
    show_default=True,
    help="Identified drone: a TOML file or a name.",
)
@options.output("CSV file for the flights, one row each.", run_folder.PREDICTION.name)
@click.option(
    "--trials",
    default=16,
    show_default=True,
    type=click.IntRange(1, 1000),
    help="Flights of each policy.",
)
@click.option(
    "--duration",
    default=20.0,
    show_default=True,
    type=options.Range(0.1, 600.0),
    help="Longest flight, seconds.",
)
@click.option(
    "--randomize",
    callback=options.randomization("trim", "posterior"),
    help="trim: constant torques and thrust differ as between the identified flights, the default "
    "where the drone's file tells how; posterior: drones drawn from its posterior; or the half "
    "width of the parameters' box, 0 for the drone as it is.",
)
@click.option(
    "--control",
    type=click.Choice(options.CONTROLS),
    help="What the authors' policies command; unless given, what their files' names begin with or "
    "their folder is called. Ours say it.",
)
@click.option(
    "--firmware",
    default="2021.10",
    show_default=True,
    type=click.Choice(["2021.10", "2026.08"]),
    help="2021.10 as the authors' drone ran it, or 2026.08, for which attitude-rate and attitude "
    "policies of ours are trained.",
)
@click.option(
    "--today",
    type=click.Path(path_type=Path),
    metavar="LOGS",
    help="A log or folder of flights of today, by any controller: trims and thrust are theirs.",
)
@options.accept_bounds
@options.seed
@options.as_json
@options.overwrite
def predict(
    policies: tuple[Path, ...],
    drone_: str,
    output: Path,
    trials: int,
    duration: float,
    randomize: float | str | None,
    control: str | None,
    firmware: str,
    today: Path | None,
    accept_bounds: bool,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Predict how long POLICIES would fly on the real drone.

    POLICIES are files or folders. Those of maidenflight and of Gronauer et al., of all control
    structures together, fly the circle on the identified drone as the authors' drone ran them: at
    their rate, by its firmware, from hover, until a guard trips. All of it is simulated.
    """
    options.must_exist(drone_)
    options.must_be_new(output, overwrite)
    cores.as_devices()
    from maidenflight import workflow

    _, notes = workflow.task_to_fly(workflow.policy_files(policies), "circle")
    options.print_notes(notes)
    with terminal.progress("predict", None) as move:
        move(0, None, "compiling")
        files, flown = workflow.predict_with(
            drone_,
            policies,
            seed,
            output,
            trials=trials,
            duration=duration,
            randomization=randomize,
            structure=control,
            firmware=firmware,
            accept_bounds=accept_bounds,
            on_policy=lambda done, of: move(done, of, "policies flown"),
            today=today,
        )

    policies_shown = _flight_times_content(files, flown)
    longest = max(entry["mean_duration"] for entry in policies_shown)
    best = [
        file
        for file, entry in zip(files, policies_shown, strict=True)
        if entry["mean_duration"] == longest
    ]

    def text() -> None:
        flight_output.flight_times(flown)
        if len(files) > 1:
            flight_output.best(best, f"longest mean, {longest:.2f} s")
        print(f"written to {output}")

    content = {
        "policies": policies_shown,
        "best": str(best[0]),
        "notes": notes,
        "simulated": True,
        "output": str(output),
    }
    follows = ("export", best[0], *workflow.export_options(best[0], control))
    options.emit(as_json, content, text, follows)


def _flight_times_content(files: list[Path], flown: "DataFrame") -> list[dict[str, Any]]:
    from maidenflight.experiments.flight_times import QUANTILES, summary

    parts = flown.partition_by("policy", maintain_order=True)
    return [
        {
            "file": str(file),
            "control": row["control"],
            "mean_duration": round(row["mean"], 6),
            "quantiles": {
                f"{percent / 100:g}": round(row[f"quantile_{percent}"], 6) for percent in QUANTILES
            },
            "end_reasons": dict(Counter(part["end_reason"].to_list()).most_common()),
        }
        for file, row, part in zip(files, summary(flown).iter_rows(named=True), parts, strict=True)
    ]
