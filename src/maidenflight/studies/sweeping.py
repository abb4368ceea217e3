"""The driver of a study: gives an engine what is not computed yet, and gathers one table."""

import dataclasses
import os
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Any

import polars

from maidenflight import manifest, results, run_folder
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.studies import engine as engines
from maidenflight.studies import status
from maidenflight.studies.engine import Engine, Resources
from maidenflight.studies.status import Progress
from maidenflight.studies.store import Folder, Store, opened
from maidenflight.studies.study import Study, Task, of, read_study, to_cell
from maidenflight.studies.worker import DONE, LOST, Order, TaskResult, product_of
from maidenflight.verb import find_verb

LOSSES = 5
"""How often a task may be lost with its process or node before it counts as failed."""
_POLL_S, _REPORT_S = 1.0, 2.0
"""Longest wait for the engine, and time between two writings of the progress [s]."""


def sweep(
    tasks: StrPath | Sequence[Mapping[str, Any]],
    output: StrPath = "study",
    on: str | Engine = "local",
    *,
    resources: Resources | None = None,
    retries: int = 1,
    on_progress: Callable[[Progress], None] | None = None,
    trust: bool = False,
) -> polars.DataFrame:
    """Computes a study: what is not there yet, on one machine or many.

    Writes a folder a task to `output`, and `study.csv`. A script that calls it needs
    `if __name__ == "__main__":` about it where it runs on `local`, which starts processes.

    Args:
        tasks: a study's TOML file, or its tables as dictionaries.
        output: folder that all machines share, or an address of fsspec such as s3://BUCKET/STUDY.
        on: `local`, `ray`, `ray:ADDRESS`, `slurm`, `slurm:PARTITION`, or an engine.
        resources: tasks at once, cores and GPUs of each, options of sbatch; one core each unless
            given.
        retries: how often a task that fails is begun again.
        on_progress: called with how far it is, about each second.
        trust: whether a TOML file may name Python code, `MODULE:NAME`, which is then imported.

    Returns:
        A row a row of each task, in the order of the study: `task`, `kind`, what is swept as
        `ENTRY.SETTING`, and the task's results.

    Raises:
        InputError: the study is wrong (see `study.of`) or the engine cannot be used, before any
            task runs; or tasks have failed, after all others are done. Their tracebacks are in
            `failures` beside the results; the same call tries them again.
    """
    resources = resources or Resources()
    cpus, gpus = resources.cpus, resources.gpus
    study = (
        read_study(tasks, cpus, gpus, trust=trust)
        if isinstance(tasks, str | os.PathLike)
        else of(list(tasks), cpus=cpus, gpus=gpus)
    )
    store = opened(output)
    release = results.claim(output) if isinstance(store, Folder) else lambda: None
    try:
        failures = compute(study, store, on, resources, retries, on_progress)
        table = gather(study, store, skipped=failures.keys() | blocked(study, failures))
    finally:
        release()
    if failures:
        raise InputError(describe_failures(study, failures, output))
    return table


def describe_failures(study: Study, failures: Mapping[str, str], output: StrPath) -> str:
    """Returns what to say of tasks that failed."""
    first = next(task for task in study.tasks if task.key in failures)
    waiting = blocked(study, failures)
    rest = f", and {len(waiting)} wait for them" if waiting else ""
    last = failures[first.key].strip().split("\n")[-1]
    return (
        f"{len(failures)} of {len({task.key for task in study.tasks})} tasks failed{rest}; the "
        f"first is {first.label}: {last} Tracebacks are in {output}/failures/; the same command "
        "tries again."
    )


def blocked(study: Study, failures: Mapping[str, str]) -> set[str]:
    """Returns keys of tasks whose inputs failed, or are such themselves."""
    keys: set[str] = set()
    for task in study.tasks:
        if any(key in failures or key in keys for key in task.inputs.values()):
            keys.add(task.key)
    return keys


def compute(
    study: Study,
    store: Store,
    on: str | Engine,
    resources: Resources,
    retries: int = 1,
    on_progress: Callable[[Progress], None] | None = None,
) -> dict[str, str]:
    """Computes the tasks whose results are not in a store.

    Args:
        study: the tasks.
        store: of the results.
        on: see `sweep`.
        resources: what the engine may use.
        retries: how often a task that fails is begun again.
        on_progress: called with how far it is.

    Returns:
        By its key, the message of each task that failed as often as it may.

    Raises:
        InputError: the engine cannot be used.
    """
    there = store.keys()
    driving = _Driving(study, store, there, retries, on if isinstance(on, str) else "")
    if driving.over:
        driving.tell(on_progress, "ended")
        return {}
    logs = os.path.join(os.path.abspath(store.address), "slurm")
    if isinstance(on, str):
        engine = engines.engine(on, dataclasses.replace(resources, logs=logs))
    else:
        engine = on
    try:
        while not driving.over:
            while engine.room() > 0 and (order := driving.next_order(resources)) is not None:
                engine.submit(order)
            driving.tell(on_progress)
            for ending in engine.ended(_POLL_S):
                driving.on_task_end(ending)
        driving.tell(on_progress, "ended")
    except BaseException:
        driving.tell(None, "interrupted")
        raise
    finally:
        engine.close()
    store.tidy()
    return driving.failures


class _Driving:
    """What is done, with the engine and still to do of a study's tasks, by key."""

    def __init__(self, study: Study, store: Store, there: set[str], retries: int, on: str):
        self.failures: dict[str, str] = {}
        self._tasks = {task.key: task for task in study.tasks}
        self._home, self._store, self._retries, self._on = study.home, store, retries, on
        self._there = there & self._tasks.keys()
        self._found = len(self._there)
        self._before: dict[str, set[str]] = {}
        self._after: dict[str, list[str]] = {}
        for key, task in self._tasks.items():
            if key not in self._there:
                self._before[key] = set(task.inputs.values()) - self._there
                for source in self._before[key]:
                    self._after.setdefault(source, []).append(key)
        self._ready = deque(key for key, before in self._before.items() if not before)
        self._running: dict[str, None] = {}
        self._failed_times: dict[str, int] = {}
        self._lost_times: dict[str, int] = {}
        self._policies = self._repeated = 0
        self._began, self._written = time.monotonic(), -_REPORT_S

    @property
    def over(self) -> bool:
        """Whether nothing runs and nothing can be begun."""
        return not (self._ready or self._running)

    def next_order(self, resources: Resources) -> Order | None:
        """Returns a task to begin, or none."""
        if not self._ready:
            return None
        task = self._tasks[self._ready.popleft()]
        self._running[task.key] = None
        products = {
            name: (key, product_of(find_verb(self._tasks[key].kind)))
            for name, key in task.inputs.items()
        }
        return Order(
            task.key,
            task.kind,
            task.label,
            dict(task.settings),
            products,
            str(self._home),
            self._store.address,
            resources.cpus,
            resources.gpus,
        )

    def on_task_end(self, ending: TaskResult) -> None:
        """Takes note of how a task ended."""
        key, task = ending.key, self._tasks[ending.key]
        del self._running[key]
        if ending.outcome == DONE:
            self._there.add(key)
            counted = find_verb(task.kind).counted
            self._policies += task.settings[counted] if counted else 0
            self._store.drop(_place(task))
            for later in self._after.get(key, ()):
                self._before[later].discard(key)
                if not self._before[later]:
                    self._ready.append(later)
            return
        self._store.write(_place(task), f"{task.label}\n{ending.message.strip()}\n")
        times, most = self._failed_times, self._retries
        if ending.outcome == LOST:
            times, most = self._lost_times, LOSSES
        times[key] = times.get(key, 0) + 1
        if times[key] > most:
            self.failures[key] = ending.message
        else:
            self._repeated += 1
            self._ready.append(key)

    def tell(self, on_progress: Callable[[Progress], None] | None, state: str = "running") -> None:
        """Tells how far it is, to others from time to time."""
        seconds = time.monotonic() - self._began
        computed, left = len(self._there) - self._found, len(self._tasks) - len(self._there)
        running = self._running if state == "running" else ()
        now = Progress(
            tasks=len(self._tasks),
            existing_count=self._found,
            computed=computed,
            running=tuple(self._tasks[key].label for key in running),
            failed=tuple(self._tasks[key].label for key in self.failures),
            repeated=self._repeated,
            seconds=seconds,
            policies_per_hour=3600.0 * self._policies / seconds if self._policies else None,
            seconds_left=seconds / computed * left if computed else None,
            on=self._on,
            state=state,
        )
        if on_progress is not None:
            on_progress(now)
        if state != "running" or time.monotonic() - self._written >= _REPORT_S:
            status.write_status(
                self._store, dataclasses.replace(now, running=now.running[: status.NAMED])
            )
            self._written = time.monotonic()


def _place(task: Task) -> str:
    """Where the traceback of a task goes."""
    return f"failures/{task.name}_{task.key}.txt"


def gather(study: Study, store: Store, skipped: AbstractSet[str] = frozenset()) -> polars.DataFrame:
    """Returns one table of the results of a study; writes it too.

    Args:
        study: the tasks.
        store: of the results.
        skipped: keys of tasks that have none.

    Returns:
        See `sweep`. Without a column for an axis that no row has.
    """
    rows: list[dict[str, Any]] = []
    for task in study.tasks:
        if task.key not in skipped:
            point = {name: to_cell(value) for name, value in task.point.items()}
            rows += [
                {"task": task.name, "kind": task.kind, **point, **row}
                for row in store.result(task.key)["rows"]
            ]
    if not rows:
        return polars.DataFrame(schema=run_folder.STUDY.columns)
    columns = list(dict.fromkeys(name for row in rows for name in row))
    swept = [name for name in columns if "." in name]
    order = ["task", "kind", *swept, *(name for name in columns[2:] if name not in swept)]
    table = polars.DataFrame(
        {name: [row.get(name) for row in rows] for name in order}, strict=False
    )
    settings = {"study": list(study.entries), "cpus": study.cpus, "gpus": study.gpus}
    record = results.record(seed=None, inputs=[], settings=settings)
    store.write(run_folder.STUDY.name, run_folder.STUDY.to_text(table, record))
    if isinstance(store, Folder):
        written = Path(store.address, run_folder.STUDY.name)
        manifest.append(store.address, "sweep", {"study": [written]}, record)
    return table
