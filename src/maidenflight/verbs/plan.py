"""`Plan`: the flight from which most of a drone can be identified."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from maidenflight.errors import InputError
from maidenflight.settings import flag, listed, number, setting
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from maidenflight.identification.design import planning


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
        listed(
            number(0.0, 1e4),
            "width, depth and height in metres, such as 2x2x1.5",
            "WxDxH",
            separator="x",
            count=3,
        ),
        (2.0, 2.0, 1.5),
        "Width x depth x height in metres; the drone takes off in the middle of the floor, and 0.2 "
        "m at walls and ceiling stay free.",
        "Flight",
    )
    seconds: float = setting(
        number(4.0, 600.0), 60.0, "Length of the flight, without take-off and landing."
    )
    interest: tuple[str, ...] | None = setting(
        shared.PARAMETERS,
        None,
        "Parameters to determine, such as latency,inertia_x.",
        name="for",
        usual="what DRONE's logs lack, by its file; all that identify may find",
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
        from maidenflight import parameters
        from maidenflight.experiments import drones
        from maidenflight.identification.design import planning
        from maidenflight.simulator.realities.virtual_drone import must_be_virtual

        cure = "Plan for a drone's TOML file or name, or virtual:SEED."
        reality = must_be_virtual(drones.find_reality(self.drone, self.accept_bounds), cure)
        gaps = _find_gaps(self.drone)
        request = planning.Request(
            *(self.room, self.seconds, self.interest, self.rate, self.motors),
            firmware=self.firmware,
            seed=self.seed,
            is_named=self.drone in parameters.DRONES,
            gaps=tuple(gaps),
        )
        try:
            flight_plan = planning.plan(reality, request, self.key, on_stage=progress.move)
        except InputError as error:
            sticks = "; ".join(dict.fromkeys(filter(None, gaps.values())))
            raise InputError(f"{error} By hand: {sticks}." if sticks else str(error)) from error
        drone = shared.own_files(self.drone)
        record = self.make_record(drone)
        plan = dataclasses.replace(flight_plan.plan, record=record)
        plan.write(output)
        return Result(
            content={
                "manoeuvres": [
                    {**dataclasses.asdict(block.manoeuvre), "seconds": block.seconds}
                    for block in plan.blocks
                ],
                "seconds": plan.seconds,
                "expected": {
                    name: dataclasses.asdict(widths) for name, widths in plan.expected.items()
                },
                "untold": list(flight_plan.unidentifiable),
                "left_out": flight_plan.left_out,
                "extremes": None if plan.extremes is None else dataclasses.asdict(plan.extremes),
                "notes": list(flight_plan.notes),
                "output": str(output),
            },
            summary=_summarize(flight_plan),
            written={"plan": [output]},
            read={"drone": drone},
            record=record,
            rows=[
                {"manoeuvre": block.manoeuvre.name, "seconds": block.seconds}
                for block in plan.blocks
            ],
            notes=flight_plan.notes,
            next=("record", "--plan", output),
            next_remark="simulated; a Crazyflie flies it by fly --plan",
            value=dataclasses.replace(flight_plan, plan=plan),
        )


def _find_gaps(drone: str) -> dict[str, str]:
    """Returns the parameters that a drone's file says its logs lack, and what tells each."""
    from maidenflight.identification import drone_file

    if not shared.own_files(drone):
        return {}
    file = drone_file.read(drone)
    return dict.fromkeys(file.unidentified, "") | {tip.parameter: tip.action for tip in file.advice}


def _summarize(flight_plan: "planning.PlanResult") -> list[Table | str]:
    """Returns the manoeuvres, the intervals to expect, and how far the drone goes."""
    from maidenflight.verbs.parts import logs_output

    plan = flight_plan.plan
    blocks = [{"name": block.manoeuvre.name, "seconds": block.seconds} for block in plan.blocks]
    rows = []
    for name, interval in plan.expected.items():
        scale, unit = logs_output.scale_of(name, interval.plausible)
        widths = {key: scale * width for key, width in dataclasses.asdict(interval).items()}
        remark = "not determined" if name in flight_plan.unidentifiable else ""
        rows.append(widths | {"name": name, "unit": unit, "remark": remark})
    columns = {"parameter": "{name}", "unit": "{unit}", "plan": "{plan:.2g}"}
    columns |= {"as long a hover": "{hover:.2g}", "plausible": "{plausible:.2g}", "": "{remark}"}
    parts: list[Table | str] = [
        Table(
            f"Plan of {plan.seconds:g} s",
            {"manoeuvre": "{name}", "seconds": "{seconds:g}"},
            blocks,
        ),
        Table("Half of the 95 % interval to expect", columns, rows),
        "of a log with position, velocity and attitude, at the rate of --rate; without these wider",
    ]
    if plan.extremes is not None:
        far = plan.extremes
        parts.append(
            f"in simulation at most {far.lateral_x:.2f} and {far.lateral_y:.2f} m from the "
            f"take-off along x and y, {far.lowest:.2f} to {far.highest:.2f} m high, "
            f"{57.3 * far.tilt:.0f} deg of tilt, {far.speed:.1f} m/s"
        )
    by_hand: dict[str, float] = {}
    for block in plan.blocks:
        sticks = block.manoeuvre.by_hand
        by_hand[sticks] = by_hand.get(sticks, 0.0) + block.seconds
    sticks = ", ".join(f"{name} {seconds:g} s" for name, seconds in by_hand.items() if name)
    return [*parts, f"by hand, where an autopilot takes no plan (PX4, ArduPilot): {sticks}"]
