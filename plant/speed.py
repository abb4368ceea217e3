"""How much faster than real time the plant serves the tests' stand-in firmware, by pipe.

Flies each control structure from take-off for 30 s, the stand-in in this process and the plant in
another, and times the flight from its second second on, when both have compiled.

    python plant/speed.py
"""

import statistics
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

from maidenflight_plant import lock_step

sys.path.insert(0, str(Path(__file__).parent / "tests"))
stand_in: Any = import_module("stand_in")

SECONDS = 30
COMMAND = [
    sys.executable,
    "-m",
    "maidenflight",
    "plant",
    "virtual:7",
    "--pipe",
    "--duration",
]


def times_real_time(structure: str) -> float:
    """Simulated seconds a second of one flight."""
    pilot = stand_in.Firmware(structure)
    with subprocess.Popen(
        [*COMMAND, str(SECONDS)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as served:
        assert served.stdin is not None
        assert served.stdout is not None
        start = 0.0
        while message := served.stdout.read(lock_step.SENSORS.size):
            served.stdin.write(pilot.answer(message))
            served.stdin.flush()
            if len(pilot.path) == 1000:
                start = time.perf_counter()
    return (SECONDS - 1) / (time.perf_counter() - start)


def main() -> None:
    """Prints the median of three flights of each structure."""
    for structure in stand_in.STRUCTURES:
        rates = [times_real_time(structure) for _ in range(3)]
        print(f"{structure:14} {statistics.median(rates):5.1f} times real time")


if __name__ == "__main__":
    main()
