"""The engine of SLURM, through submitit: one job a task."""

import os
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from maidenflight.errors import InputError, imported
from maidenflight.studies import worker
from maidenflight.studies.engine import Resources
from maidenflight.studies.worker import FAILED, LOST, Order, TaskResult

_MOST = 200
"""Jobs in the queue at once by default; many clusters allow a few hundred a user."""
_MINUTES = 24 * 60
"""Longest time of a task by default [min]."""
_POLLED = 0.2
"""Time between two looks for the files of jobs [s]."""
_LISTED_S = 10.0
"""Time between two looks at the queue [s]."""
_UNDER_WAY = {
    *("PENDING", "CONFIGURING", "RUNNING", "SUSPENDED", "STOPPED", "RESIZING"),
    *("REQUEUED", "REQUEUE_HOLD", "REQUEUE_FED", "SIGNALING", "STAGE_OUT", "COMPLETING"),
}
"""States of jobs that may still write a result."""


def in_job(order: Order) -> TaskResult:
    """Does a task in a job; JAX sees no GPU without a request for one."""
    if not order.gpus:
        os.environ["CUDA_VISIBLE_DEVICES"] = ""
    return worker.perform(order)


class Slurm:
    """Tasks as jobs of SLURM, whose nodes have maidenflight installed and share the store."""

    def __init__(self, resources: Resources, partition: str = "", cluster: str = "slurm"):
        """Begins with no jobs.

        Args:
            resources: what tasks may use.
            partition: of the cluster; its default by default.
            cluster: `slurm`, or `local` for jobs that are processes of this machine, to try it.

        Raises:
            InputError: submitit is not installed, there is no SLURM here, or an option is unknown.
        """
        self._submitit = submitit = imported("submitit", "slurm", "--on slurm")
        try:
            self._executor = submitit.AutoExecutor(folder=resources.logs, cluster=cluster)
        except RuntimeError as error:
            raise InputError(
                f"no SLURM here ({error}). Run the study on a login node, which has sbatch."
            ) from error
        options: dict[str, Any] = {"name": "maidenflight", "timeout_min": _MINUTES}
        options["cpus_per_task"] = resources.cpus
        if resources.gpus:
            options["gpus_per_node"] = resources.gpus
        if cluster == "slurm":
            own = dict(resources.slurm) | ({"partition": partition} if partition else {})
            options["slurm_additional_parameters"] = own
            # A job that is preempted is submitted again by the study, which also counts it.
            options["slurm_use_srun"] = False
        self._executor.update_parameters(**options)
        self._most = resources.workers or _MOST
        self._busy: dict[str, Any] = {}
        self._gone: set[str] = set()
        self._listed = time.monotonic()
        self._queued = cluster == "slurm"

    def room(self) -> int:
        """See `Engine`."""
        return self._most - len(self._busy)

    def submit(self, order: Order) -> None:
        """See `Engine`.

        Raises:
            InputError: SLURM refuses the job.
        """
        try:
            self._busy[order.key] = self._executor.submit(in_job, order)
        except self._submitit.core.utils.FailedJobError as error:
            message = " ".join(str(error).split())[-300:]
            raise InputError(
                f"SLURM refuses the job of {order.label} ({message}). Give other options: --slurm "
                "NAME=VALUE, --cpus, --gpus."
            ) from error

    def ended(self, timeout: float) -> Sequence[TaskResult]:
        """See `Engine`."""
        until = time.monotonic() + timeout
        while True:
            lost_jobs = self._lost()
            endings = [
                self._ending(key, job)
                for key, job in list(self._busy.items())
                if key in lost_jobs or self._over(job)
            ]
            if endings or time.monotonic() >= until:
                return endings
            time.sleep(_POLLED)

    def _over(self, job: Any) -> bool:
        """Whether a job has written its result; submitit's own way asks a database, if any."""
        return job.paths.result_pickle.exists() if self._queued else job.done()

    def _lost(self) -> set[str]:
        """Keys of jobs that left the queue without a result, as when they are killed.

        A job counts once two looks at the queue do not find it: a file may appear late.
        """
        if not self._queued or not self._busy or time.monotonic() - self._listed < _LISTED_S:
            return set()
        self._listed = time.monotonic()
        try:
            command = ["squeue", "--noheader", "--me", "--states=all", "--format=%A %T"]
            listed = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
        except (OSError, subprocess.SubprocessError):  # no answer says nothing of jobs
            return set()
        there = {
            words[0]
            for words in map(str.split, listed.stdout.splitlines())
            if len(words) == 2 and words[1] in _UNDER_WAY
        }
        gone = {key for key, job in self._busy.items() if job.job_id not in there}
        lost, self._gone = gone & self._gone, gone
        return lost

    def _ending(self, key: str, job: Any) -> TaskResult:
        del self._busy[key]
        if not self._over(job):
            return TaskResult(key, LOST, f"job {job.job_id} left the queue without a result")
        try:
            return job.result()
        except self._submitit.core.utils.UncompletedJobError as error:
            return TaskResult(key, LOST, str(error).strip().split("\n")[0])
        except Exception as error:  # what stopped the job before the task
            return TaskResult(key, FAILED, f"{type(error).__name__}: {error}")

    def close(self) -> None:
        """See `Engine`."""
        for job in self._busy.values():
            with suppress(OSError):
                job.cancel()
        self._busy = {}
