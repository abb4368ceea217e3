"""`Sweep`: a study of many tasks, on one machine or many."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import run_folder, terminal
from maidenflight.settings import REQUIRED, flag, path, setting, table, text, whole
from maidenflight.verb import Output, Progress, Result, Verb

if TYPE_CHECKING:
    from maidenflight.studies.status import Progress as Status


class Sweep(Verb):
    """Compute a STUDY: many tasks, on one machine or many.

    STUDY is a TOML file; docs/clusters.md describes it. What is interrupted goes on with the same
    command.
    """

    output = Output(
        "study",
        "Folder for the results, which all machines share, or an address such as s3://BUCKET/X. "
        "Results that are there are not computed again.",
    )
    steady = False
    resumable_from = "."
    in_studies = False

    study: Path = setting(path("a study's TOML file"), REQUIRED, argument=True, files=True)
    on: str = setting(
        text("an engine", "ENGINE"),
        "local",
        "Where tasks run: local, ray, ray:ADDRESS, slurm or slurm:PARTITION.",
        "Machines",
    )
    workers: int | None = setting(
        whole(1, 100_000), None, "Tasks at once at most; as many as there is room for unless given."
    )
    cpus: int = setting(
        whole(1, 1024), 1, "Cores of each task. Results of another number are others."
    )
    gpus: int = setting(whole(0, 64), 0, "GPUs of each task, likewise; without them JAX sees none.")
    retries: int = setting(
        whole(0, 100),
        1,
        "How often a task that fails is begun again. One that is lost with its node always is.",
    )
    slurm: dict[str, str] = setting(
        table(text(), "options of sbatch by name, such as account=lab"),
        {},
        "Option of sbatch, such as account=lab or time=120; may be repeated.",
    )
    status: bool = setting(flag(), False, "Only print how far the study is.", recorded=False)

    def places(self, output: Any) -> list[Path]:
        """Returns the folder; an address of another machine is not locked."""
        return [output] if isinstance(output, Path) and not self.status else []

    def may_replace(self, place: Path) -> bool:
        """Returns true: what is there is gone on with."""
        return True

    def discard(self, output: Any) -> None:
        """Removes the results that the study would find there."""
        from maidenflight.studies import store as stores
        from maidenflight.studies.study import read

        store = stores.opened(str(output))
        for task in read(self.study, self.cpus, self.gpus).tasks:
            store.remove(task.key)

    def compute(self, output: Any, progress: Progress) -> Result:
        """Computes what is not there; gathers one table."""
        from maidenflight.studies import status, sweeping
        from maidenflight.studies import store as stores
        from maidenflight.studies.engine import Resources
        from maidenflight.studies.study import read

        study, address = read(self.study, self.cpus, self.gpus), str(output)
        store = stores.opened(address)
        if self.status:
            state = status.read(store, study)
            return Result(
                content=dataclasses.asdict(state), show=lambda: _show_status(state, address)
            )
        last: list[Status] = []

        def on_progress(now: "Status") -> None:
            last[:] = [now]
            progress.move(now.done, now.tasks, _describe(now))

        resources = Resources(self.workers, self.cpus, self.gpus, self.slurm)
        failures = sweeping.compute(study, store, self.on, resources, self.retries, on_progress)
        waiting = sweeping.blocked(study, failures)
        rows = sweeping.gather(study, store, failures.keys() | waiting)
        now = last[0]

        def show() -> None:
            _show_status(now, address)
            print(f"{rows.height} rows, written to {address}/{run_folder.STUDY.name}")

        return Result(
            content={
                "tasks": now.tasks,
                "found": now.found,
                "computed": now.computed,
                "failed": list(now.failed),
                "waiting": len(waiting),
                "rows": rows.to_dicts(),
                "output": address,
            },
            show=show,
            next=("report", address),
            error=sweeping.told(study, failures, address) if failures else "",
            value=rows,
        )


def _describe(now: "Status") -> str:
    """Returns how far a study is, in a line."""
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


def _show_status(now: "Status", output: str) -> None:
    """Prints how far a study is."""
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
    terminal.print_table(f"Study {output}", ["", ""], [[name, str(value)] for name, value in rows])
    for name in now.failed[:10]:
        print(f"failed: {name}")
