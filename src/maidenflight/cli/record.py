"""record and fly: flight logs, of a virtual drone or of a real Crazyflie."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from maidenflight import cache, run_folder, terminal
from maidenflight.cli import options
from maidenflight.errors import InputError

_TASKS = ("circle", "figure_eight", "hover")
_URI = "radio://0/80/2M/E7E7E7E7E7"

_task = click.option(
    "--task",
    default="circle",
    show_default=True,
    type=click.Choice(_TASKS),
    help="What the real drone flies.",
)
_height = click.option(
    "--height",
    default=1.0,
    show_default=True,
    type=options.Range(0.3, 1.6),
    help="Metres above the ground at which the real drone flies; a policy was trained for 1.",
)


def _flights(default: int) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    return click.option(
        "--flights",
        "count",
        default=default,
        show_default=True,
        type=click.IntRange(1, 999),
        help="How many flights.",
    )


def _duration(
    default: float, least: float, what: str
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    return click.option(
        "--duration",
        default=default,
        show_default=True,
        type=options.Range(least, 600.0),
        help=what,
    )


@click.command()
@options.output("Folder for the logs.", "flights")
@click.option(
    "--uri",
    help=f"Record a real Crazyflie at this address, such as {_URI}. Read docs/pilot.md first.",
)
@click.option(
    "--reality",
    default="virtual:7",
    show_default=True,
    help=f"What flies: {options.REALITIES}.",
)
@_flights(4)
@_duration(30.0, 2.0, "Seconds of each.")
@click.option(
    "--excitation",
    default=0.06,
    show_default=True,
    type=options.Range(0.0, 0.3),
    help="Random thrust on each motor of a virtual drone, as a share of full thrust; it makes lag "
    "and latency visible. 0: plain PID.",
)
@click.option(
    "--rate",
    default=500,
    show_default=True,
    type=click.IntRange(1, 500),
    help="Rows a second of a virtual drone's log, a divisor of 500: 500 as on a micro-SD card, 100 "
    "as by radio, which holds one command in five.",
)
@click.option(
    "--firmware",
    default="2021.10",
    show_default=True,
    type=click.Choice(["2021.10", "2026.08"]),
    help="Firmware whose PID flies a virtual drone and compensates for its battery: that of the "
    "paper's flights, or today's, which lets thrust commands exceed 1.",
)
@click.option(
    "--controller",
    default="pid",
    show_default=True,
    type=click.Choice(["pid", "mellinger"]),
    help="Controller of the firmware that flies a virtual drone.",
)
@click.option(
    "--steps",
    default=0.1,
    show_default=True,
    type=options.Range(0.0, 0.2),
    help="Random steps of a real drone's set-point, in metres, twice a second, for the same end. "
    "0: the plain reference.",
)
@_task
@_height
@click.option(
    "--plan",
    "plan_file",
    type=options.PATH,
    help="Fly this plan of maidenflight plan instead, once unless --flights is given.",
)
@click.option(
    "--recover",
    is_flag=True,
    help="Fly nothing; make the logs that a crash has left as rows in the folder.",
)
@options.accept_bounds
@options.seed
@options.as_json
@options.overwrite
@click.pass_context
def record(
    context: click.Context,
    output: Path,
    uri: str | None,
    reality: str,
    count: int,
    duration: float,
    excitation: float,
    rate: int,
    firmware: str,
    controller: str,
    steps: float,
    task: str,
    height: float,
    plan_file: Path | None,
    recover: bool,
    accept_bounds: bool,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Record flights, of a virtual drone or a real Crazyflie.

    They are flown by the firmware's position PID or by --controller: on a virtual drone
    (simulated), or with --uri on a real one, whose log comes by radio at 100 Hz. A real drone takes
    off, follows the reference and lands. Ctrl-C lands it, a second Ctrl-C stops its motors. Every
    row is on disk as soon as it has come; logs are added to the folder and never replaced.
    """
    given = options.given(context).keys()
    virtual, real = (
        {
            "reality",
            "excitation",
            "rate",
            "firmware",
            "controller",
            "accept_bounds",
            "overwrite",
        },
        {"steps", "task", "height"},
    )
    if wrong := sorted(given & (virtual if uri else real)):
        raise click.UsageError(
            f"--{wrong[0].replace('_', '-')} is for "
            f"{'virtual drones' if uri else 'a real drone (--uri)'}. Leave it out."
        )
    if plan_file is not None:
        told = given & {
            "duration",
            "controller",
            "excitation",
            "steps",
            "task",
            "height",
            "recover",
        }
        if told:
            raise click.UsageError(
                f"--{min(told)}: the plan says what is flown. Leave it or --plan out."
            )
        if "count" not in given:
            count = 1
    if recover:
        _recover(output, as_json)
        return
    if uri and plan_file is not None:
        from maidenflight.flights import flight_plan

        planned = flight_plan.read(plan_file)
        _fly_really(uri, output, as_json, plan=planned, count=count, seed=seed)
        return
    if uri:
        _fly_really(
            uri,
            output,
            as_json,
            task=task,
            count=count,
            duration=duration,
            height=height,
            steps=steps,
            seed=seed,
        )
        return
    options.must_be_new(output, overwrite)
    from maidenflight import workflow
    from maidenflight.flights import flight_plan

    planned = None if plan_file is None else flight_plan.read(plan_file)
    with terminal.progress("record", None) as move:
        move(0, None, "compiling and flying")
        truth, flown = output / run_folder.REALITY, workflow.reality(reality, accept_bounds)
        if planned is None:
            written = workflow.record(
                flown, seed, output, truth, count, duration, excitation, rate, firmware, controller
            )
        else:
            duration = planned.seconds
            written = workflow.record_planned(
                flown, planned, seed, output, truth, count, rate, firmware
            )
    known = str(truth) if truth.exists() else None
    content = {
        "flights": [str(path) for path in written],
        "truth": known,
        "simulated": True,
    }
    where = f"; the true parameters are in {run_folder.REALITY}" if known else ""
    options.emit(
        as_json,
        content,
        lambda: print(
            f"{count} simulated flight{'s' * (count > 1)} of {duration:g} s in {output}/{where}"
        ),
        ("identify", output),
    )


@click.command()
@options.output("Folder for the logs.", "flown")
@click.option(
    "--uri",
    required=True,
    help=f"Address of the Crazyflie, such as {_URI}. Read docs/pilot.md first.",
)
@_flights(1)
@_duration(10.0, 1.0, "Seconds that the policy flies in each.")
@click.option(
    "--full-scale-counts",
    type=options.Range(30000.0, 65535.0),
    help="Firmware counts of a thrust command of 1, if not those of the exported policy.",
)
@_task
@_height
@options.seed
@options.as_json
def fly(uri: str, output: Path, as_json: bool, **asked: Any) -> None:
    """Fly the policy on board a real Crazyflie.

    The firmware's PID takes off before it and lands after it. The exported app must be on the
    drone. Ctrl-C hands back to the PID and lands, a second Ctrl-C stops the motors.
    """
    _fly_really(uri, output, as_json, steps=0.0, policy=True, **asked)


def _fly_really(uri: str, output: Path, as_json: bool, **asked: Any) -> None:
    from maidenflight.link import session
    from maidenflight.link.flying import COMPLETE

    say = (
        (lambda text: print(text, file=sys.stderr, flush=True))
        if as_json
        else (lambda text: print(text, flush=True))
    )
    flown = session.record(uri, output, cache=cache.folder() / "crazyflie", say=say, **asked)
    rows = [
        {
            "flight": one.name,
            "ended": one.ending.reason,
            "packets": one.rows,
            "log": str(one.log) if one.log else None,
        }
        for one in flown
    ]

    def text() -> None:
        for note in (note for one in flown for note in one.notes):
            print(f"note: {note}")
        print(f"{len(flown)} flights in {output}/")

    content = {"flights": rows, "simulated": not uri.startswith(("radio://", "usb://"))}
    options.emit(as_json, content, text, ("identify", output))
    if len(flown) < asked["count"] or any(one.ending.reason != COMPLETE for one in flown):
        sys.exit(1)


def _recover(folder: Path, as_json: bool) -> None:
    from maidenflight.link import rows

    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder. Give the one that was recorded into, with -o.")
    made, refused = rows.recover(folder)

    def text() -> None:
        for reason in refused:
            print(f"note: {reason}")
        print(f"{len(made)} logs made of rows in {folder}/")

    content = {"logs": [str(path) for path in made], "refused": refused}
    options.emit(as_json, content, text, ("identify", folder) if made else ())
