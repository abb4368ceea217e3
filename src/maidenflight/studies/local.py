"""The engine of one machine: processes of the standard library.

Each slot has a pool of one process, so that the loss of a process tells which task it had.
"""

import os
import signal
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from contextlib import suppress
from glob import glob
from multiprocessing import get_context

from maidenflight import compiler
from maidenflight.errors import InputError
from maidenflight.studies import worker
from maidenflight.studies.engine import Resources
from maidenflight.studies.worker import LOST, Order, TaskResult

_STARTING = 5.0
"""Longest wait for the number of a process that is just starting, to end it [s]."""


def _gpus() -> list[str]:
    """GPUs of this machine by number: those that the environment allows, else all."""
    allowed = os.environ.get("CUDA_VISIBLE_DEVICES")
    if allowed is not None:
        return [gpu for gpu in allowed.split(",") if gpu]
    devices = sorted(glob("/dev/nvidia[0-9]*"), key=lambda name: int(name[len("/dev/nvidia") :]))
    return [name[len("/dev/nvidia") :] for name in devices]


class _Slot:
    """A process for one task at a time."""

    def __init__(self, gpus: str) -> None:
        self.gpus = gpus
        self._pool = ProcessPoolExecutor(
            1, get_context("spawn"), initializer=worker.begin, initargs=(os.getpid(), gpus)
        )
        self._process = self._pool.submit(os.getpid)

    def submit(self, order: Order) -> Future[TaskResult]:
        return self._pool.submit(worker.perform, order)

    def close(self) -> None:
        """Ends the process, whatever it is doing."""
        with suppress(BrokenExecutor, TimeoutError, OSError):
            os.kill(self._process.result(_STARTING), getattr(signal, "SIGKILL", signal.SIGTERM))
        self._pool.shutdown(wait=True, cancel_futures=True)


class Local:
    """Tasks in processes of this machine."""

    def __init__(self, resources: Resources, address: str = ""):
        """Begins with as many processes as cores and GPUs allow, each started when needed.

        Raises:
            InputError: there are not as many GPUs, or there is an address.
        """
        if address:
            raise InputError(
                f"local:{address}: expected local, which is this machine, or ray:{address}."
            )
        self._most = resources.workers or max(1, compiler.count_cores() // resources.cpus)
        self._gpus = [""] * self._most
        if resources.gpus:
            available, each = _gpus(), resources.gpus
            if len(available) < each:
                raise InputError(
                    f"a task is to have {each} GPUs, but this machine shows {len(available)}."
                    " Leave out --gpus, or look whether its driver is installed."
                )
            self._most = min(self._most, len(available) // each)
            self._gpus = [",".join(available[n * each : (n + 1) * each]) for n in range(self._most)]
        self._idle: list[_Slot] = []
        self._busy: dict[Future[TaskResult], tuple[_Slot, str]] = {}

    def room(self) -> int:
        """See `Engine`."""
        return self._most - len(self._busy)

    def submit(self, order: Order) -> None:
        """See `Engine`."""
        slot = self._idle.pop() if self._idle else _Slot(self._gpus.pop())
        self._busy[slot.submit(order)] = slot, order.key

    def ended(self, timeout: float) -> Sequence[TaskResult]:
        """See `Engine`."""
        endings = []
        for future in wait(self._busy, timeout, FIRST_COMPLETED).done:
            slot, key = self._busy.pop(future)
            try:
                endings.append(future.result())
                self._idle.append(slot)
            except BrokenExecutor:
                slot.close()
                self._gpus.append(slot.gpus)
                endings.append(
                    TaskResult(key, LOST, "its process was killed, as when memory is full")
                )
        return endings

    def close(self) -> None:
        """See `Engine`."""
        for slot in [*self._idle, *(slot for slot, _ in self._busy.values())]:
            slot.close()
        self._idle, self._busy = [], {}
