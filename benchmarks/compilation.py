"""Measures what each verb of a command spends: processor time, and of the wall time that of JAX.

Tracing, making XLA's input, and XLA itself, with programs and those of them read from the cache.

    python benchmarks/compilation.py demo -o /tmp/demo

With `JAX_COMPILATION_CACHE_DIR` an empty folder is cold, and the same again is warm. What a thread
of another verb compiles meanwhile counts for both.
"""

import functools
import resource
import sys
import time
from collections import Counter
from typing import Any

import jax

from maidenflight import cli, terminal
from maidenflight.verb import Result, Verb

EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "tracing, s",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "to XLA, s",
    "/jax/core/compile/backend_compile_duration": "XLA, s",
}
COLUMNS = ("processor, s", "wall, s", *EVENTS.values(), "programs", "from the cache")


def spent(so_far: Counter[str]) -> Counter[str]:
    """What this process and those it waited for have spent, by `COLUMNS`."""
    both = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    processor = sum(one.ru_utime + one.ru_stime for one in both)
    return Counter(so_far) + Counter({COLUMNS[0]: processor, COLUMNS[1]: time.perf_counter()})  # type: ignore[dict-item]


def main() -> None:
    """Runs the command line in this process."""
    so_far: Counter[str] = Counter()
    rows: list[list[str]] = []

    def count(event: str, duration_secs: float, **kwargs: Any) -> None:
        so_far[EVENTS.get(event, "")] += duration_secs  # type: ignore[assignment]
        so_far["programs"] += event.endswith("backend_compile_duration")

    def hit(event: str, **kwargs: Any) -> None:
        so_far["from the cache"] += event.endswith("/cache_hits")

    jax.monitoring.register_event_duration_secs_listener(count)
    jax.monitoring.register_event_listener(hit)
    run = Verb.run

    @functools.wraps(run)
    def run_timed(self: Verb, *values: Any, **keywords: Any) -> Result:
        before = spent(so_far)
        result = run(self, *values, **keywords)
        after = spent(so_far)
        rows.append([self.name, *(f"{after[one] - before[one]:.1f}" for one in COLUMNS)])
        return result

    Verb.run = run_timed  # type: ignore[method-assign]
    try:
        cli.main()
    finally:
        terminal.print_table("What each verb spends", ["", *COLUMNS], rows)


if __name__ == "__main__":
    sys.argv[0] = "maidenflight"
    main()
