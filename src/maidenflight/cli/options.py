"""Options that commands share, and what every command does about them."""

import json
import shlex
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import click

from maidenflight.errors import InputError

CONTROLS = ("pwm", "attitude_rate", "attitude")
TASKS = ("circle", "figure_eight", "fast_circle", "fast_figure_eight", "hover", "take_off")
PROPELLERS = ("2.1+", "legacy", "thrust-upgrade")
REALITIES = (
    "near:SEED, virtual:SEED or far:SEED, with growing mismatch to the training model; "
    "near:SEED@DRONE and so on, about a drone of your own; "
    "pybullet:SEED (virtual:SEED in PyBullet); l2f:DRONE or crazyflow:DRONE, in those simulators; "
    "MODULE:FACTORY of your own; or a drone's TOML file; +sensors, +10ms, +yaw6000, +weak10 and "
    "+payload15 behind any of them"
)
PATH = click.Path(path_type=Path)


def given(context: click.Context) -> dict[str, str]:
    """Parameters that the command line gives, by name: how they are written there."""
    return {
        option.name: option.opts[0]
        for option in context.command.params
        if option.name is not None
        and context.get_parameter_source(option.name) is click.core.ParameterSource.COMMANDLINE
    }


class Range(click.FloatRange):
    """A range of numbers; nan, which is neither below nor above anything, is none of them."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Reads a number."""
        number = super().convert(value, param, ctx)
        if number != number:
            self.fail(f"{value!r} is not a number.", param, ctx)
        return number


seed = click.option(
    "--seed",
    default=0,
    show_default=True,
    help="Random seed; the same seed gives the same results.",
)
as_json = click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print one JSON object on standard output and nothing else there.",
)
mass = click.option(
    "--mass",
    type=Range(min=5.0, max=5000.0),
    metavar="GRAMS",
    help="Mass of what flies, battery and decks included; that of the drone unless given. Inertia "
    "and thrust-to-weight ratio follow it.",
)
accept_bounds = click.option(
    "--accept-bounds",
    is_flag=True,
    help="Take a drone although an identified parameter lies at a bound of its search, where its "
    "interval is too narrow.",
)
overwrite = click.option("--overwrite", is_flag=True, help="Replace results of an earlier run.")
commands = click.option(
    "--commands",
    type=click.Choice(["zero-order-hold", "subsampled"]),
    help="What commands stand for in logs that do not say it: each acts until the "
    "next row, as a policy's, or the log is subsampled from the firmware's faster PID, which is "
    "assumed unless given. Taken the wrong way, latency is half a row off.",
)
battery_law = click.option(
    "--battery-law",
    metavar="NAME",
    help="Battery compensation by which logged PWM is read as thrust: '2.1+ propellers', 'legacy "
    "propellers', 'thrust upgrade', 'firmware of 2021', 'firmware of 2021, before it compensates', "
    "'2.1 Brushless', or 'unknown, PWM squared'. The logs decide unless given.",
)


def output(
    what: str, default: str | None = None
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Where results go; a command may do without a default."""
    return click.option("-o", "--output", default=default, show_default=True, type=PATH, help=what)


def randomization(
    *words: str,
) -> Callable[[click.Context, click.Parameter, str | None], float | str | None]:
    """Reads a half width or one of the words."""

    def read(_: click.Context, __: click.Parameter, given: str | None) -> float | str | None:
        if given is None or given in words:
            return given
        try:
            width = float(given)
        except ValueError:
            width = -1.0
        if not 0.0 <= width <= 0.9:
            raise click.BadParameter(
                f"{given!r}; expected a number from 0 to 0.9, or {' or '.join(words)}."
            )
        return width

    return read


def layers(_: click.Context, __: click.Parameter, given: str | None) -> tuple[int, ...] | None:
    """Reads sizes of hidden layers, such as 50,50."""
    if given is None:
        return None
    sizes = tuple(int(size) for size in given.split(",") if size.strip().isdecimal())
    if len(sizes) != given.count(",") + 1 or not all(1 <= size <= 1024 for size in sizes):
        raise click.BadParameter(
            f"{given!r}; expected numbers from 1 to 1024 with commas between them, such as 50,50."
        )
    return sizes


def must_exist(drone: str) -> None:
    """Refuses a drone's TOML file that is not there, before anything heavy is imported.

    Raises:
        InputError: there is no such file.
    """
    if drone.endswith(".toml") and not Path(drone).exists():
        raise InputError(
            f"{drone}: no such drone. Identify one (maidenflight identify LOGS -o {drone}), or "
            "give another file or a name (maidenflight drone --list)."
        )


def must_be_new(path: Path, overwrite: bool, resume: bool | None = None) -> None:
    """Refuses a place where something is or another process writes, and locks it for this one.

    Args:
        path: where the command is to write.
        overwrite: whether it may replace what is there.
        resume: whether it is to go on with what is there; None for a command that cannot.

    Raises:
        InputError: something is there, or another process writes there.
    """
    from maidenflight import results

    click.get_current_context().call_on_close(results.claim(path))
    # What a killed run leaves of a file that it was writing is nothing to keep.
    taken = set(path.iterdir()) > set(results.leftovers(path)) if path.is_dir() else path.exists()
    if taken and not (overwrite or resume):
        ways = ["Choose another place with -o", "or allow it with --overwrite"]
        if resume is not None:
            ways.insert(1, "go on with what was interrupted there by --resume")
        raise InputError(f"{path}: already there. {', '.join(ways)}.")


def print_notes(notes: Iterable[str]) -> None:
    """Prints what the user should know of a result, on standard error."""
    for note in notes:
        print(f"note: {note}", file=sys.stderr)


def emit(
    as_json: bool,
    content: dict[str, Any],
    text: Callable[[], None],
    then: Sequence[object] = (),
    remark: str = "",
) -> None:
    """Prints a command's result: its content as JSON if asked for, or what `text` prints.

    Args:
        as_json: whether it is asked for.
        content: for JSON.
        text: prints it for people.
        then: the words of the command that comes next, for people.
        remark: what else they should know of it.
    """
    if as_json:
        print(json.dumps(content))
        return
    text()
    if then:
        command = shlex.join(["maidenflight", *map(str, then)])
        print(f"next: {command}{f'  ({remark})' if remark else ''}")
