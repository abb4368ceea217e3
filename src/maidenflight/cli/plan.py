"""The command plan: the flight that tells most of a drone."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from maidenflight import terminal
from maidenflight.cli import options

if TYPE_CHECKING:
    from maidenflight.identification.planning import Planned


def _room(_: click.Context, __: click.Parameter, given: str) -> tuple[float, float, float]:
    try:
        width, depth, height = map(float, given.lower().split("x"))
    except ValueError:
        raise click.BadParameter(
            f"{given!r}; expected width, depth and height in metres, such as 2x2x1.5."
        ) from None
    return width, depth, height


@click.command()
@click.argument("drone", default="crazyflie")
@click.option(
    "--room",
    default="2x2x1.5",
    show_default=True,
    callback=_room,
    help="Width x depth x height in metres; the drone takes off in the middle of the floor, and "
    "0.2 m at walls and ceiling are kept free.",
)
@click.option(
    "--seconds",
    default=60.0,
    show_default=True,
    type=options.Range(4.0, 600.0),
    help="Length of the flight, without take-off and landing.",
)
@click.option(
    "--for",
    "interest",
    help="Parameters to tell, such as latency,inertia_x; all that identify may find unless given.",
)
@click.option(
    "--rate",
    default=500,
    show_default=True,
    type=click.IntRange(1, 500),
    help="Rows a second of the log from which the drone is to be identified: 500 as on a micro-SD "
    "card, 100 as by radio.",
)
@click.option(
    "--motors",
    is_flag=True,
    help="Allow random thrust on each motor too, which virtual drones take, a real one does not.",
)
@click.option(
    "--firmware",
    default="2021.10",
    show_default=True,
    type=click.Choice(["2021.10", "2026.08"]),
    help="Firmware whose PID flies.",
)
@options.output("TOML file for the plan.", "plan.toml")
@options.accept_bounds
@options.seed
@options.as_json
@options.overwrite
def plan(
    drone: str,
    room: tuple[float, float, float],
    seconds: float,
    interest: str | None,
    rate: int,
    motors: bool,
    firmware: str,
    output: Path,
    accept_bounds: bool,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Propose the flight that tells most of a drone.

    DRONE is a drone's TOML file, a named drone or virtual:SEED: what is known of it so far. Each
    manoeuvre of a library is simulated on it and on drones about it; those that leave the room or
    tilt too much are left out, and the seconds of the others are chosen so that the parameters are
    told best. record --plan flies it.
    """
    options.must_exist(drone)
    options.must_be_new(output, overwrite)
    names = None
    if interest is not None:
        names = [name.strip() for name in interest.split(",") if name.strip()]
        if not names:
            raise click.BadParameter("--for names no parameter; such as --for latency,inertia_x.")
    from maidenflight import workflow

    with terminal.progress("plan", None) as move:
        found = workflow.plan_for(
            drone,
            seed,
            output,
            room,
            seconds,
            names,
            rate,
            motors,
            firmware,
            accept_bounds,
            on_stage=move,
        )
    options.print_notes(found.notes)
    options.emit(
        as_json,
        _content(found) | {"output": str(output)},
        lambda: _show(found, output),
        ("record", "--plan", output),
    )


def _content(found: "Planned") -> dict[str, Any]:
    made = found.plan
    return {
        "manoeuvres": [
            {**asdict(block.manoeuvre), "seconds": block.seconds} for block in made.blocks
        ],
        "seconds": made.seconds,
        "expected": {name: asdict(one) for name, one in made.expected.items()},
        "untold": list(found.untold),
        "left_out": found.left_out,
        "extremes": None if made.extremes is None else asdict(made.extremes),
        "notes": list(found.notes),
    }


def _show(found: "Planned", output: Path) -> None:
    from maidenflight.parameters import COMPONENTS, QUANTITIES

    made = found.plan
    terminal.table(
        f"Plan of {made.seconds:g} s",
        ["manoeuvre", "seconds"],
        [[block.manoeuvre.name, f"{block.seconds:g}"] for block in made.blocks],
        numbers_from=1,
    )
    rows = []
    for name, one in made.expected.items():
        unit = QUANTITIES[COMPONENTS[name][0]].unit
        remark = "not told" if name in found.untold else ""
        rows.append([name, unit, *_halves(asdict(one)), remark])
    terminal.table(
        "Half of the 95 % interval to expect",
        ["parameter", "unit", "plan", "as long a hover", "plausible", ""],
        rows,
        numbers_from=2,
    )
    if made.extremes is not None:
        far = made.extremes
        print(
            f"in simulation at most {far.lateral_x:.2f} and {far.lateral_y:.2f} m from the "
            f"take-off along x and y, {far.lowest:.2f} to {far.highest:.2f} m high, "
            f"{57.3 * far.tilt:.0f} deg of tilt, {far.speed:.1f} m/s"
        )
    print(f"written to {output}")


def _halves(one: Mapping[str, float]) -> list[str]:
    return [f"{one[part]:.2g}" for part in ("plan", "hover", "plausible")]
