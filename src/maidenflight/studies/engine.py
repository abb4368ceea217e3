"""What brings tasks to workers, by one interface: `local`, `ray`, `slurm`, or your own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from maidenflight.registry import ENGINES
from maidenflight.studies.worker import Order, TaskResult


@runtime_checkable
class Engine(Protocol):
    """Brings tasks to workers. One object is of one run of a study."""

    def room(self) -> int:
        """Returns how many more tasks it takes now."""
        ...

    def submit(self, order: Order) -> None:
        """Begins a task, by `worker.perform`."""
        ...

    def ended(self, timeout: float) -> Sequence[TaskResult]:
        """Tasks that have ended since the last call.

        Args:
            timeout: longest wait for one [s].
        """
        ...

    def close(self) -> None:
        """Ends what is still under way, and frees its resources."""
        ...


@dataclass(frozen=True)
class Resources:
    """What a run may use."""

    workers: int | None = None
    """Tasks at once at most; as many as there is room for by default."""
    cpus: int = 1
    """Of a task."""
    gpus: int = 0
    """Of a task."""
    slurm: Mapping[str, str] = field(default_factory=dict)
    """Options of sbatch."""
    logs: str = ""
    """Folder for scripts and output of jobs, which their machines share."""


def engine(name: str, resources: Resources) -> Engine:
    """Returns an engine by name.

    Args:
        name: `local`, `ray`, `ray:ADDRESS`, `slurm`, `slurm:PARTITION`, or `NAME` or `NAME:PLACE`
            with another name of `registry.ENGINES`.
        resources: what it may use.

    Raises:
        InputError: there is no such engine, its package is not installed, or it cannot be reached.
    """
    kind, _, address = name.partition(":")
    return ENGINES[kind](resources, address)
