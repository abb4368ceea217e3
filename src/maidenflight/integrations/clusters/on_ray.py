"""The engine of Ray: one machine, a cluster, Kubernetes or a cloud."""

from collections.abc import Sequence
from typing import Any

from maidenflight.errors import InputError, imported
from maidenflight.studies import worker
from maidenflight.studies.engine import Resources
from maidenflight.studies.worker import FAILED, LOST, Order, TaskResult

_MOST = 1000
"""Tasks that Ray holds at once; it starts them as there are resources."""


class OnRay:
    """Tasks in a Ray cluster, whose machines have maidenflight installed and share the store."""

    def __init__(self, resources: Resources, address: str = ""):
        """Connects to a cluster.

        Args:
            resources: what tasks may use.
            address: of the cluster's head; without one, what RAY_ADDRESS says, a cluster that runs
                on this machine, or else one of this machine that is started for the study.

        Raises:
            InputError: Ray is not installed, or the cluster cannot be reached.
        """
        self._ray = ray = imported("ray", "ray", "--on ray")
        self._own = not ray.is_initialized()
        if self._own:
            try:
                ray.init(address or None, log_to_driver=False, configure_logging=False)
            except (ConnectionError, RuntimeError, ValueError) as error:
                host = address or "this machine"
                raise InputError(
                    f"no Ray cluster at {host} ({error}). Start one (ray start --head), or give "
                    "its address: --on ray:HOST:6379."
                ) from error
        # What is lost is submitted again by the study, which also counts it.
        self._perform = ray.remote(worker.perform).options(
            num_cpus=resources.cpus, num_gpus=resources.gpus, max_retries=0
        )
        self._most = resources.workers or _MOST
        self._busy: dict[Any, str] = {}

    def room(self) -> int:
        """See `Engine`."""
        return self._most - len(self._busy)

    def submit(self, order: Order) -> None:
        """See `Engine`."""
        self._busy[self._perform.remote(order)] = order.key

    def ended(self, timeout: float) -> Sequence[TaskResult]:
        """See `Engine`."""
        if not self._busy:
            return []
        references, endings = list(self._busy), []
        # Waits for one, and takes all that are there.
        if self._ray.wait(references, num_returns=1, timeout=timeout)[0]:
            for reference in self._ray.wait(references, num_returns=len(references), timeout=0)[0]:
                key = self._busy.pop(reference)
                try:
                    endings.append(self._ray.get(reference))
                except self._ray.exceptions.RayTaskError as error:
                    endings.append(TaskResult(key, FAILED, str(error)))
                except self._ray.exceptions.RayError as error:
                    endings.append(TaskResult(key, LOST, str(error).strip().split("\n")[0]))
        return endings

    def close(self) -> None:
        """See `Engine`."""
        for reference in self._busy:
            self._ray.cancel(reference, force=True)
        self._busy = {}
        if self._own:
            self._ray.shutdown()
