"""sweep: a study of many tasks, on one machine or many."""

import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from maidenflight import run_folder, terminal
from maidenflight.cli import options
from maidenflight.cli.interruption import resumable
from maidenflight.errors import InputError

if TYPE_CHECKING:
    from maidenflight.studies.status import Progress


def _named(_: click.Context, __: click.Parameter, given: tuple[str, ...]) -> dict[str, str]:
    for entry in given:
        if not entry.partition("=")[0] or "=" not in entry:
            raise click.BadParameter(f"{entry!r}; expected NAME=VALUE, such as account=lab.")
    return {name: value for name, _, value in (entry.partition("=") for entry in given)}


@click.command()
@click.argument("study", type=options.PATH)
@click.option(
    "-o",
    "--output",
    default="study",
    show_default=True,
    help="Folder for the results, which all machines share, or an address such as s3://BUCKET/X. "
    "Results that are there are not computed again.",
)
@click.option(
    "--on",
    default="local",
    show_default=True,
    help="Where tasks run: local, ray, ray:ADDRESS, slurm or slurm:PARTITION.",
)
@click.option(
    "--workers",
    type=click.IntRange(1, 100_000),
    help="Tasks at once at most; as many as there is room for unless given.",
)
@click.option(
    "--cpus",
    default=1,
    show_default=True,
    type=click.IntRange(1, 1024),
    help="Cores of each task. Results of another number are others.",
)
@click.option(
    "--gpus",
    default=0,
    show_default=True,
    type=click.IntRange(0, 64),
    help="GPUs of each task, likewise; without them JAX sees none.",
)
@click.option(
    "--retries",
    default=1,
    show_default=True,
    type=click.IntRange(0, 100),
    help="How often a task that fails is begun again. One that is lost with its node always is.",
)
@click.option(
    "--slurm",
    multiple=True,
    callback=_named,
    metavar="NAME=VALUE",
    help="Option of sbatch, such as account=lab or time=120; may be repeated.",
)
@click.option("--status", is_flag=True, help="Only print how far the study is.")
@options.as_json
@options.overwrite
def sweep(
    study: Path,
    output: str,
    on: str,
    workers: int | None,
    cpus: int,
    gpus: int,
    retries: int,
    slurm: dict[str, str],
    status: bool,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Compute a STUDY: many tasks, on one machine or many.

    STUDY is a TOML file; docs/clusters.md describes it. What is interrupted goes on with the same
    command.
    """
    from maidenflight.studies import status as state
    from maidenflight.studies import store as stores
    from maidenflight.studies.study import read

    asked = read(study, cpus, gpus)
    store = stores.opened(output)
    if status:
        now = state.read(store, asked)
        options.emit(as_json, dataclasses.asdict(now), lambda: _print_status(now, output))
        return
    if isinstance(store, stores.Folder):
        options.must_be_new(Path(output), overwrite, resume=True)
    if overwrite:
        for task in asked.tasks:
            store.remove(task.key)
    from maidenflight.studies import sweeping
    from maidenflight.studies.engine import Resources

    last: list[Progress] = []
    with (
        terminal.progress("sweep", None, remaining=False) as move,
        resumable(Path(output), again=""),
    ):

        def hear(now: "Progress") -> None:
            last[:] = [now]
            move(now.done, now.tasks, _remark(now))

        failures = sweeping.compute(
            asked, store, on, Resources(workers, cpus, gpus, slurm), retries, hear
        )
    waiting = sweeping.blocked(asked, failures)
    table = sweeping.gather(asked, store, failures.keys() | waiting)
    now = last[0]
    content = {
        "tasks": now.tasks,
        "found": now.found,
        "computed": now.computed,
        "failed": list(now.failed),
        "waiting": len(waiting),
        "rows": table.to_dicts(),
        "output": output,
    }

    def text() -> None:
        _print_status(now, output)
        print(f"{table.height} rows, written to {output}/{run_folder.STUDY.name}")

    options.emit(as_json, content, text, () if failures else ("report", output))
    if failures:
        sys.stdout.flush()
        raise InputError(sweeping.told(asked, failures, output))


def _remark(now: "Progress") -> str:
    """How far a study is, in a line."""
    parts = [f"{now.done} of {now.tasks} tasks", f"{len(now.running)} running"]
    parts += [f"{len(now.failed)} failed"] if now.failed else []
    parts += [f"{now.policies_per_hour:.0f} policies/h"] if now.policies_per_hour else []
    parts += [f"{_clock(now.seconds_left)} left"] if now.seconds_left else []
    return ", ".join(parts)


def _clock(seconds: float | None) -> str:
    if seconds is None:
        return "unknown"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"


def _print_status(now: "Progress", output: str) -> None:
    rate = "" if now.policies_per_hour is None else f"{now.policies_per_hour:.0f}"
    rows: list[tuple[str, Any]] = [
        ("state", {"silent": "no driver writes; begin again"}.get(now.state, now.state)),
        ("tasks", now.tasks),
        ("done", now.done),
        ("running", len(now.running)),
        ("failed", len(now.failed)),
        ("begun again", now.repeated),
        ("policies an hour", rate),
        ("time", _clock(now.seconds)),
        ("time left", _clock(now.seconds_left) if now.state == "running" else ""),
    ]
    terminal.table(f"Study {output}", ["", ""], [[name, str(value)] for name, value in rows])
    for name in now.failed[:10]:
        print(f"failed: {name}")
