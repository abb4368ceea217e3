"""`Plan`: the flight from which most of a drone can be identified."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight import terminal
from maidenflight.settings import flag, listed, number, setting
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import logs, shared

if TYPE_CHECKING:
    from maidenflight.identification.planning import Planned

_ROOM = listed(
    number(0.0, 1e4), "width, depth and height in metres, such as 2x2x1.5", "WxDxH", separator="x"
)


class Plan(Verb):
    """Propose the flight from which most of a DRONE can be identified.

    DRONE is a drone's TOML file, a named drone or virtual:SEED: what is known of it so far. Each
    manoeuvre of a library is simulated on it and on drones about it; those that leave the room or
    tilt too much are left out, and the seconds of the others are chosen so that the parameters are
    determined best. record and fly take it by --plan.
    """

    output = Output("plan.toml", "TOML file for the plan.")

    drone: str = shared.drone("crazyflie", argument=True)
    room: tuple[float, float, float] = setting(
        dataclasses.replace(_ROOM, accepts=lambda room: _ROOM.accepts(room) and len(room) == 3),
        (2.0, 2.0, 1.5),
        "Width x depth x height in metres; the drone takes off in the middle of the floor, and 0.2 "
        "m at walls and ceiling are kept free.",
        "Flight",
    )
    seconds: float = setting(
        number(4.0, 600.0), 60.0, "Length of the flight, without take-off and landing."
    )
    interest: tuple[str, ...] | None = setting(
        shared.PARAMETERS,
        None,
        "Parameters to determine, such as latency,inertia_x; all that identify may find unless "
        "given.",
        name="for",
    )
    rate: int = shared.rate()
    motors: bool = setting(
        flag(),
        False,
        "Allow random thrust on each motor too, which virtual drones take, a real one does not.",
    )
    firmware: str = shared.firmware("Firmware whose PID flies.")
    accept_bounds: bool = shared.accept_bounds()
    seed: int = shared.seed()

    def check_early(self) -> None:
        """Refuses a drone that is not there."""
        shared.must_exist(self.drone)

    def compute(self, output: Path, progress: Progress) -> Result:
        """Plans; writes the plan."""
        import jax

        from maidenflight import parameters
        from maidenflight.experiments.drones import find_reality
        from maidenflight.identification import planning
        from maidenflight.simulator.virtual_drone import must_be_virtual

        cure = "Plan for a drone's TOML file or name, or virtual:SEED."
        known = must_be_virtual(find_reality(self.drone, self.accept_bounds), cure)
        found = planning.plan(
            *(known, self.room, self.seconds, jax.random.key(self.seed)),
            interest=self.interest,
            rate=self.rate,
            motors=self.motors,
            firmware=self.firmware,
            seed=self.seed,
            held=self.drone in parameters.DRONES,
            on_stage=progress.move,
        )
        record = self.make_record(logs.own_files(self.drone))
        found = dataclasses.replace(found, plan=dataclasses.replace(found.plan, record=record))
        found.plan.write(output)

        def show() -> None:
            _show(found)
            print(f"written to {output}")

        return Result(
            content=_to_content(found) | {"output": str(output)},
            show=show,
            written={"plan": [output]},
            read={"drone": logs.own_files(self.drone)},
            record=record,
            rows=[
                {"manoeuvre": block.manoeuvre.name, "seconds": block.seconds}
                for block in found.plan.blocks
            ],
            notes=found.notes,
            next=("record", "--plan", output),
            value=found,
        )


def _to_content(found: "Planned") -> dict[str, Any]:
    plan = found.plan
    return {
        "manoeuvres": [
            {**dataclasses.asdict(block.manoeuvre), "seconds": block.seconds}
            for block in plan.blocks
        ],
        "seconds": plan.seconds,
        "expected": {name: dataclasses.asdict(one) for name, one in plan.expected.items()},
        "untold": list(found.untold),
        "left_out": found.left_out,
        "extremes": None if plan.extremes is None else dataclasses.asdict(plan.extremes),
        "notes": list(found.notes),
    }


def _show(found: "Planned") -> None:
    """Prints the manoeuvres, the intervals to expect, and how far the drone goes."""
    from maidenflight.parameters import COMPONENTS, QUANTITIES

    plan = found.plan
    terminal.print_table(
        f"Plan of {plan.seconds:g} s",
        ["manoeuvre", "seconds"],
        [[block.manoeuvre.name, f"{block.seconds:g}"] for block in plan.blocks],
    )
    rows = []
    for name, one in plan.expected.items():
        unit = QUANTITIES[COMPONENTS[name][0]].unit
        halves = (f"{half:.2g}" for half in (one.plan, one.hover, one.plausible))
        rows.append([name, unit, *halves, "not determined" if name in found.untold else ""])
    columns = ["parameter", "unit", "plan", "as long a hover", "plausible", ""]
    terminal.print_table("Half of the 95 % interval to expect", columns, rows, numbers_from=2)
    if plan.extremes is not None:
        far = plan.extremes
        print(
            f"in simulation at most {far.lateral_x:.2f} and {far.lateral_y:.2f} m from the "
            f"take-off along x and y, {far.lowest:.2f} to {far.highest:.2f} m high, "
            f"{57.3 * far.tilt:.0f} deg of tilt, {far.speed:.1f} m/s"
        )
