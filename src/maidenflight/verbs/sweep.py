"""`Sweep`: a study of many tasks, on one machine or many."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import run_folder
from maidenflight.settings import REQUIRED, flag, path, setting, table, text, whole
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Verb

if TYPE_CHECKING:
    from maidenflight.studies.status import Progress as Status
    from maidenflight.studies.study import Study


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
        consent=True,
    )
    workers: int | None = setting(
        whole(1, 100_000), None, "Tasks at once at most; as many as there is room for by default."
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
        consent=True,
    )
    trust: bool = setting(
        flag(),
        False,
        "Import the Python code, MODULE:NAME, that the study names as a kind or a reality.",
        consent=True,
        recorded=False,
    )
    status: bool = setting(flag(), False, "Only print how far the study is.", recorded=False)

    def places(self, output: Any) -> list[Path]:
        """Returns the folder; an address of another machine is not locked."""
        return [output] if isinstance(output, Path) and not self.status else []

    def may_replace(self, path: Path) -> bool:
        """Returns true: what is there is continued."""
        return True

    def discard(self, output: Any) -> None:
        """Removes the results that the study would find there."""
        from maidenflight.studies.store import opened as open_store

        store = open_store(str(output))
        for task in self._read_study().tasks:
            store.remove(task.key)

    def _read_study(self) -> "Study":
        from maidenflight.studies.study import read_study

        return read_study(self.study, self.cpus, self.gpus, trust=self.trust)

    def compute(self, output: Any, progress: Progress) -> Result:
        """Computes what is not there; gathers one table."""
        from maidenflight.studies import sweeping
        from maidenflight.studies.engine import Resources
        from maidenflight.studies.status import Progress as Status
        from maidenflight.studies.status import read_status
        from maidenflight.studies.store import opened as open_store

        study, address = self._read_study(), str(output)
        store = open_store(address)
        if self.status:
            state = read_status(store, study)
            return Result(content=dataclasses.asdict(state), summary=_summarize(state, address))
        last: list[Status] = []

        def on_progress(now: "Status") -> None:
            last[:] = [now]
            progress.move(now.done, now.tasks, now.describe())

        resources = Resources(self.workers, self.cpus, self.gpus, self.slurm)
        failures = sweeping.compute(study, store, self.on, resources, self.retries, on_progress)
        waiting = sweeping.blocked(study, failures)
        rows = sweeping.gather(study, store, failures.keys() | waiting)
        now = last[0]
        return Result(
            content={
                "tasks": now.tasks,
                "found": now.existing_count,
                "computed": now.computed,
                "failed": list(now.failed),
                "waiting": len(waiting),
                "rows": rows.to_dicts(),
                "output": address,
            },
            summary=[
                *_summarize(now, address),
                f"{rows.height} rows, written to {address}/{run_folder.STUDY.name}",
            ],
            next=("report", address),
            error=sweeping.describe_failures(study, failures, address) if failures else "",
            value=rows,
        )


def _summarize(now: "Status", output: str) -> list[Table | str]:
    from maidenflight.studies.status import clock

    running, rate = now.state == "running", now.policies_per_hour
    rows: dict[str, Any] = {
        "state": {"silent": "no driver writes; begin again"}.get(now.state, now.state),
        "tasks": now.tasks,
        "done": now.done,
        "running": len(now.running),
        "failed": len(now.failed),
        "begun again": now.repeated,
        "policies an hour": "" if rate is None else f"{rate:.0f}",
        "time": clock(now.seconds),
        "time left": clock(now.seconds_left) if running else "",
    }
    columns = {"": "{name}", " ": "{value}"}
    return [
        Table(f"Study {output}", columns, [{"name": k, "value": v} for k, v in rows.items()]),
        *(f"failed: {name}" for name in now.failed[:10]),
    ]
