"""How busy a study keeps its workers: tasks of one second that take no computing.

    python benchmarks/cluster_overhead.py --on local
    python benchmarks/cluster_overhead.py --on ray

There are as many workers as cores. Busy is the time that tasks took over the time that workers were
there, from the call to the table, start of processes included. Reported in docs/clusters.md.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

import maidenflight as mf
from maidenflight import compiler
from maidenflight.errors import require_packages
from maidenflight.settings import number, setting, whole
from maidenflight.verb import Progress, Result, Verb


class Wait(Verb):
    """Waits."""

    place: int = setting(whole(0, 10**6))
    seconds: float = setting(number(0, 60), 1.0)

    def compute(self, output: Path, progress: Progress) -> Result:
        """Waits; writes nothing."""
        began = time.perf_counter()
        time.sleep(self.seconds)
        return Result(rows=[{"took": time.perf_counter() - began}])


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--on", default="local")
    options.add_argument("--tasks", type=int, default=1000)
    arguments = options.parse_args()
    engine = arguments.on.partition(":")[0]
    require_packages(*{"ray": ["ray"], "slurm": ["submitit"]}.get(engine, []))
    # Workers import this file by its name.
    places = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    os.environ["PYTHONPATH"] = os.pathsep.join(places)
    entry = {
        "name": "seconds",
        "kind": "cluster_overhead:Wait",
        "grid": {"place": {"first": 0, "count": arguments.tasks}},
    }
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        table = mf.sweep([entry], folder, arguments.on)
        took = time.perf_counter() - began
    workers = compiler.count_cores()
    share = float(table["took"].sum()) / (workers * took)
    print(
        f"{arguments.on}: {arguments.tasks} tasks of a second with {workers} workers took "
        f"{took:.1f} s; busy {100 * share:.1f} %"
    )


if __name__ == "__main__":
    main()
