"""Flies the exported app in the plant: 30 flights of 20 s without a fault, and each guard's fault.

Writes a table of paper/notes/export.md. Estimator and PID of the firmware are our models; the app
is what `export` writes, compiled for this computer (tests/integrations/exporters/app_in_plant.py).

    maidenflight train --drone crazyflie_2.1+ --yaw-penalty 0.1 --policies 1 -o policies
    python plant/guards.py policies/policy_1.json
"""

import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import numpy as np

from maidenflight import policy_file
from maidenflight.integrations.radio.blocks import REASONS
from maidenflight_plant.running_plant import find_plant

ROOT = Path(__file__).parents[1]
for folder in ("benchmarks", "tests/common", "tests/integrations/exporters"):
    sys.path.insert(0, str(ROOT / folder))
write: Any = import_module("page").write
app_in_firmware: Any = import_module("app_in_firmware")
app_in_plant: Any = import_module("app_in_plant")
faults: Any = import_module("test_app_in_plant")

DRONE, FLIGHTS, SECONDS = "crazyflie_2.1+", 30, 20.0


class Flights:
    """Flights of one policy on its drone."""

    def __init__(self, policy: Path, drone: str = DRONE) -> None:
        """Builds the app."""
        self.drone = drone
        file = policy_file.read_policy(policy)
        self.folder = Path(tempfile.mkdtemp())
        self.library = app_in_firmware.built(file.policy, self.folder, hover=file.hover)
        self.pid, self.number = app_in_plant.Pid(), 0

    def fly(self, seed: int, task: int, seconds: float, fault: Any) -> tuple[float, str, Any]:
        """One flight; how long the policy flew, why no longer, and the loop."""
        self.number += 1
        copy = self.folder / f"{self.number}.so"
        copy.write_bytes(self.library.read_bytes())
        app = app_in_firmware.App(copy)
        app.set(task=task)
        loop = app_in_plant.Loop(app, find_plant(self.drone, seed)(), self.pid)
        flight = loop.fly(seconds, fault)
        return flight, REASONS[int(app.log("why"))], loop


@click.command()
@click.argument("policy", type=Path)
@click.option("--flights", default=FLIGHTS)
def main(policy: Path, flights: int) -> None:
    """Measures and writes the table."""
    flight, drifts, trips = Flights(policy), [], 0
    for seed in range(flights):
        largest = [0.0]

        def note(loop: Any, time: float, largest: list[float] = largest) -> None:
            drift = [loop.app.log(f"drift{axis}") for axis in "XYZ"]
            largest[0] = max(largest[0], float(np.linalg.norm(drift)))

        seconds, why, loop = flight.fly(seed, 1, SECONDS, note)
        trips += why != "nothing"
        drifts += largest
        volts = float(loop.plant.readings[16])
        click.echo(f"{seed}: {seconds:.3f} s, {why}, drift {largest[0]:.3f} m/s, {volts:.2f} V")
    rows = [
        "| flights | result |",
        "|---|---|",
        f"| {flights} of {SECONDS:g} s without a fault | {trips} trips; drift at most "
        f"{max(drifts):.2f} m/s |",
    ]
    for name, change in [*faults.FAULTS.items(), ("velocity leaps", faults.leapt)]:
        waits = []
        for seed in range(5):
            since: list[float] = []

            def fault(loop: Any, time: float, change: Any = change, since: Any = since) -> None:
                if time >= faults.BEGUN_S and change(loop):
                    since.append(time)

            seconds, why, _ = flight.fly(seed, 2, 3.0, fault)
            waits.append(1000 * (seconds - (since or [seconds])[0]))
            click.echo(f"{name} {seed}: {why} after {waits[-1]:.0f} ms")
        rows.append(f"| fault: {name} | handed back after at most {max(waits):.0f} ms |")
    write(Path(__file__).parents[1] / "paper" / "notes" / "export.md", {"guards": "\n".join(rows)})


if __name__ == "__main__":
    main()
