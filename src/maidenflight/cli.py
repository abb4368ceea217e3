"""The command line: parsing only. Nothing heavy is imported before a command runs."""

import _thread
import dataclasses
import json
import os
import platform
import shlex
import signal
import sys
import threading
import time
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from maidenflight import __version__, cores, terminal
from maidenflight.errors import InputError, WriteError
from maidenflight.training.scoreboards import BOARDS

if TYPE_CHECKING:
    from types import FrameType

    from polars import DataFrame

    from maidenflight.demo import Demo
    from maidenflight.flights.reading import Flights
    from maidenflight.training.train import Progress

_CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}
_TASKS = ("circle", "figure_eight", "hover", "take_off")
_REALITIES = "near:SEED, virtual:SEED, far:SEED, ever stranger; pybullet:SEED (virtual:SEED in PyBullet); or a drone's TOML file"


def main() -> None:
    """Entry point: exit code 2 and one line for a user's mistake, 130 when interrupted."""
    try:
        with _insisting():
            _keep_compiled()
            commands(prog_name="maidenflight", standalone_mode=False)
    except InputError as error:
        print(f"maidenflight: {error}", file=sys.stderr)
        sys.exit(2)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        print("maidenflight: interrupted; finished files are complete, the rest was not written.", file=sys.stderr)
        sys.exit(130)


@contextmanager
def _insisting() -> Iterator[None]:
    """Holds on to a Ctrl-C that Python would lose.

    One that falls into a callback of the garbage collector, JAX's or another, is dropped there, and is sent again. One that falls into the
    start of an extension module comes out as that module's ImportError, and is taken for what it was.
    """
    before, interrupted = sys.unraisablehook, False

    def dropped(what: "sys.UnraisableHookArgs") -> None:
        if not issubclass(what.exc_type, KeyboardInterrupt):
            before(what)
            return
        again = threading.Timer(0.05, _thread.interrupt_main)
        again.daemon = True
        again.start()

    def heard(number: int, frame: "FrameType | None") -> None:
        nonlocal interrupted
        interrupted = True
        signal.default_int_handler(number, frame)

    sys.unraisablehook = dropped
    own = signal.getsignal(signal.SIGINT) is signal.default_int_handler and threading.current_thread() is threading.main_thread()
    if own:
        signal.signal(signal.SIGINT, heard)
    try:
        yield
    except ImportError as error:
        if interrupted:
            raise KeyboardInterrupt from error
        raise
    finally:
        sys.unraisablehook = before
        if own:
            signal.signal(signal.SIGINT, signal.default_int_handler)


@click.group(context_settings=_CONTEXT)
@click.version_option(__version__, prog_name="maidenflight")
def commands() -> None:
    """From flight logs to a neural network that flies the real drone on its first try.

    \b
    flight logs -> identify -> validate -> train -> transfer -> export -> report
    """  # noqa: D301


def _seed(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--seed", default=0, show_default=True, help="Random seed; the same seed gives the same results.")(command)


def _as_json(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output and nothing else there.")(command)


def _overwrite(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--overwrite", is_flag=True, help="Replace results of an earlier run.")(command)


class _Range(click.FloatRange):
    """A range of numbers; nan, which is neither below nor above anything, is none of them."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Reads a number."""
        number = super().convert(value, param, ctx)
        if number != number:
            self.fail(f"{value!r} is not a number.", param, ctx)
        return number


def _output(default: str, what: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    return click.option("-o", "--output", default=default, show_default=True, type=click.Path(path_type=Path), help=what)


def _must_be_new(path: Path, overwrite: bool, or_else: str = "") -> None:
    """Refuses to write into a folder that holds something, over a file, or where another process is about to; keeps the place for us."""
    from maidenflight import results

    click.get_current_context().call_on_close(results.claim(path))
    # What a killed run leaves of a file that it was writing is nothing to keep.
    taken = set(path.iterdir()) > set(results.leftovers(path)) if path.is_dir() else path.exists()
    if taken and not overwrite:
        ways = ["Choose another place with -o", *([or_else] if or_else else []), "or allow it with --overwrite"]
        raise InputError(f"{path}: already there. {', '.join(ways)}.")


@contextmanager
def _resumable(checkpoint: Path) -> Iterator[None]:
    """Says how to go on where work is interrupted that a checkpoint, a file or a folder, holds."""
    again = shlex.join(
        ["maidenflight", *(argument for argument in sys.argv[1:] if argument not in ("--resume", "--overwrite")), "--resume"]
    )
    try:
        yield
    except KeyboardInterrupt:
        if not checkpoint.exists():
            raise
        print(f"maidenflight: interrupted; {checkpoint} holds what was reached. Go on with: {again}", file=sys.stderr)
        sys.exit(130)
    except WriteError as error:
        if not checkpoint.exists():
            raise
        raise InputError(f"{error.wrong} {checkpoint} holds what was reached. {error.remedy} and go on with: {again}") from error


_MOST_KEPT = 500_000_000
"""Bytes of compiled programs; a program has some hundred thousand."""


def _cache() -> Path:
    """The user's cache folder."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "maidenflight"


def _keep_compiled() -> None:
    """Keeps compiled programs in the user's cache folder, by processor: what was compiled once starts at once the next time.

    JAX's own variable names another folder; set to nothing it keeps none.
    """
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    folder = _cache() / f"{platform.machine()}-{zlib.crc32(_processor().encode()):08x}"
    with suppress(OSError):
        kept = sorted((entry.stat().st_mtime, entry.stat().st_size, entry) for entry in folder.glob("*-cache"))
        surplus = sum(size for _, size, _ in kept) - _MOST_KEPT
        for _, size, entry in kept:
            if surplus > 0:
                entry.unlink()
                surplus -= size
        folder.mkdir(parents=True, exist_ok=True)
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
    # What a killed process left half written, or a full disk, costs a compilation and is no news to users.
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache entry")


def _processor() -> str:
    """What compiled programs depend on: a home folder may be shared by different machines."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor()
    return "".join(sorted({line for line in text.splitlines() if line.startswith(("model name", "flags", "Features", "CPU part"))}))


def _emit(as_json: bool, content: dict[str, Any], text: Callable[[], None]) -> None:
    if as_json:
        print(json.dumps(content))
    else:
        text()


@commands.command()
@click.argument("name", default="crazyflie")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="File to write; standard output unless given.")
@_overwrite
def drone(name: str, output: Path | None, overwrite: bool) -> None:
    """Print a drone's parameters as TOML: a named drone (crazyflie) or a file, checked."""
    from maidenflight import parameters

    text = parameters.to_toml(parameters.read(name), Path(name).stem)
    if output is None:
        print(text, end="")
        return
    from maidenflight import results

    _must_be_new(output, overwrite)
    results.write(output, text)


_REAL_TASKS = ("circle", "figure_eight", "hover")
_URI = "radio://0/80/2M/E7E7E7E7E7"


def _height(command: Callable[..., Any]) -> Callable[..., Any]:
    what = "Metres above the ground at which the real drone flies; a policy was trained for 1."
    return click.option("--height", default=1.0, show_default=True, type=_Range(0.3, 1.6), help=what)(command)


def _real_task(command: Callable[..., Any]) -> Callable[..., Any]:
    what = "What the real drone flies."
    return click.option("--task", default="circle", show_default=True, type=click.Choice(_REAL_TASKS), help=what)(command)


@commands.command()
@_output("flights", "Folder for the logs.")
@click.option("--uri", help=f"Record a real Crazyflie at this address, such as {_URI}. Read docs/pilot.md first.")
@click.option("--reality", default="virtual:7", show_default=True, help=f"Which virtual drone: {_REALITIES}.")
@click.option("--flights", "count", default=4, show_default=True, type=click.IntRange(1, 999), help="How many flights.")
@click.option("--duration", default=30.0, show_default=True, type=_Range(2.0, 600.0), help="Seconds of each.")
@click.option(
    "--excitation",
    default=0.06,
    show_default=True,
    type=_Range(0.0, 0.3),
    help="Random thrust on each motor of a virtual drone, as a share of full thrust; it makes lag and latency visible. 0: plain PID.",
)
@click.option(
    "--steps",
    default=0.1,
    show_default=True,
    type=_Range(0.0, 0.2),
    help="Random steps of a real drone's set-point, in metres, twice a second, for the same end. 0: the plain reference.",
)
@_real_task
@_height
@click.option("--recover", is_flag=True, help="Fly nothing; make the logs that a crash has left as rows in the folder.")
@_seed
@_as_json
@_overwrite
@click.pass_context
def record(
    context: click.Context,
    output: Path,
    uri: str | None,
    reality: str,
    count: int,
    duration: float,
    excitation: float,
    steps: float,
    task: str,
    height: float,
    recover: bool,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Record flights at 100 Hz, flown by the firmware's position PID: on a virtual drone (simulated), or with --uri on a real Crazyflie.

    A real drone takes off, follows the task's reference and lands. Ctrl-C lands it, a second Ctrl-C stops its motors. Every row is on disk
    as soon as it has come; logs are added to the folder and never replaced.
    """
    given = {name for name in context.params if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE}
    virtual, real = {"reality", "excitation", "overwrite"}, {"steps", "task", "height"}
    if wrong := sorted(given & (virtual if uri else real)):
        raise click.UsageError(f"--{wrong[0]} is for {'virtual drones' if uri else 'a real drone (--uri)'}. Leave it out.")
    if recover:
        _recover(output, as_json)
        return
    if uri:
        _fly_really(uri, output, as_json, task=task, count=count, duration=duration, height=height, steps=steps, seed=seed)
        return
    _must_be_new(output, overwrite)
    from maidenflight import workflow

    with terminal.progress("record", None):
        written = workflow.record(workflow.reality(reality), seed, output, output / "reality.toml", count, duration, excitation)
    content = {"flights": [str(path) for path in written], "truth": str(output / "reality.toml"), "simulated": True}
    _emit(as_json, content, lambda: print(f"{count} simulated flights of {duration:g} s in {output}/; the truth is in reality.toml"))


@commands.command()
@_output("flown", "Folder for the logs.")
@click.option("--uri", required=True, help=f"Address of the Crazyflie, such as {_URI}. Read docs/pilot.md first.")
@click.option("--flights", "count", default=1, show_default=True, type=click.IntRange(1, 999), help="How many flights.")
@click.option("--duration", default=10.0, show_default=True, type=_Range(1.0, 600.0), help="Seconds that the policy flies in each.")
@click.option(
    "--full",
    default=65535.0,
    show_default=True,
    type=_Range(30000.0, 65535.0),
    help="What a thrust command of 1 is, in the firmware's counts: 65535 if identified from our own logs, 60000 from the authors'.",
)
@_real_task
@_height
@_seed
@_as_json
def fly(uri: str, output: Path, count: int, duration: float, full: float, task: str, height: float, seed: int, as_json: bool) -> None:
    """Fly the policy on board a real Crazyflie, between a take-off and a landing by the firmware's PID.

    The exported app must be on the drone. Ctrl-C hands back to the PID and lands, a second Ctrl-C stops the motors.
    """
    _fly_really(
        uri, output, as_json, task=task, count=count, duration=duration, height=height, steps=0.0, seed=seed, policy=True, full=full
    )


def _fly_really(uri: str, output: Path, as_json: bool, **asked: Any) -> None:
    from maidenflight.link import session
    from maidenflight.link.flying import COMPLETE

    say = (lambda text: print(text, file=sys.stderr, flush=True)) if as_json else (lambda text: print(text, flush=True))
    flown = session.record(uri, output, cache=_cache() / "crazyflie", say=say, **asked)
    rows = [
        {"flight": one.name, "ended": one.ending.reason, "packets": one.rows, "log": str(one.log) if one.log else None} for one in flown
    ]

    def text() -> None:
        for note in (note for one in flown for note in one.notes):
            print(f"note: {note}")
        print(f"{len(flown)} flights in {output}/; next: maidenflight identify {output}")

    _emit(as_json, {"flights": rows, "simulated": not uri.startswith(("radio://", "usb://"))}, text)
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

    _emit(as_json, {"logs": [str(path) for path in made], "refused": refused}, text)


def _bounds(_: click.Context, __: click.Parameter, given: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    pairs = {}
    for entry in given:
        try:
            name, values = entry.split("=")
            low, high = map(float, values.split(","))
        except ValueError as error:
            raise click.BadParameter(f"{entry!r}; expected NAME=LOWER,UPPER, such as latency=0,0.03.") from error
        pairs[name] = (low, high)
    return pairs


def _flights_content(flights: "Flights") -> dict[str, Any]:
    seconds = round(flights.duration, 2)
    return {
        "files": len(flights.paths),
        "pieces": len(flights),
        "seconds": seconds,
        "dropped": flights.notes,
        "refused": flights.refused,
    }


def _print_flights(flights: "Flights", windows: int) -> None:
    print(f"{len(flights.paths)} files, {len(flights)} usable pieces of flight, {flights.duration:.0f} s; {windows} windows")
    if flights.notes:
        print(f"{len(flights.notes)} notes on what was dropped, the first: {flights.notes[0]}")
    if flights.refused:
        print(f"{len(flights.refused)} files refused:", file=sys.stderr)
        for reason in flights.refused[:3]:
            print(f"  {reason}", file=sys.stderr)
        if len(flights.refused) > 3:
            print(f"  and {len(flights.refused) - 3} more; --json lists them all", file=sys.stderr)


@commands.command()
@click.argument("logs", type=click.Path(path_type=Path))
@_output("drone.toml", "TOML file for the identified drone; identification.csv goes beside it, NAME_identification.csv beside NAME.toml.")
@click.option(
    "--over",
    help="Parameters to identify, such as latency,inertia_x, or auto: those that predict flights held out better. Unless given, auto;"
    " for a replay the paper's three: thrust_to_weight,motor_time_constant,latency.",
)
@click.option(
    "--objective",
    default="likelihood",
    show_default=True,
    type=click.Choice(["likelihood", "replay"]),
    help="likelihood: one row ahead, right for flights under feedback. replay: the paper's, many rows open loop.",
)
@click.option("--start", default="crazyflie", show_default=True, help="Drone whose other parameters are kept: a name or a TOML file.")
@click.option("--length", default=30, show_default=True, type=click.IntRange(1, 500), help="T, rows of a replayed window.")
@click.option("--history", default=100, show_default=True, type=click.IntRange(1, 500), help="Rows before a window that set its motors.")
@click.option("--evaluations", default=60, show_default=True, type=click.IntRange(11, 2000), help="Most of the objective, a trial.")
@click.option("--trials", default=2, show_default=True, type=click.IntRange(1, 100), help="Repetitions of the optimiser.")
@click.option("--method", default="gradient", show_default=True, type=click.Choice(["gradient", "bayesian"]), help="Of a replay.")
@click.option("--bounds", multiple=True, callback=_bounds, help="Search bounds, NAME=LOWER,UPPER in SI units; may be repeated.")
@click.option(
    "--most-seconds",
    default=3600.0,
    show_default=True,
    type=_Range(min=10.0),
    help="Flight to use; of more, stretches of every flight are.",
)
@_seed
@_as_json
@_overwrite
def identify(
    logs: Path,
    output: Path,
    over: str | None,
    objective: str,
    start: str,
    length: int,
    history: int,
    evaluations: int,
    trials: int,
    bounds: dict[str, tuple[float, float]],
    method: str,
    most_seconds: float,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Identify a drone's parameters from LOGS, a flight log or a folder of them."""
    _must_be_new(output, overwrite)
    from maidenflight import workflow

    _must_be_new(workflow.evaluations_beside(output), overwrite)
    names = over if over in (None, "auto") else [name.strip() for name in over.split(",") if name.strip()]
    with terminal.progress("identify", None) as move:
        flights, found = workflow.identify_from(
            logs,
            seed,
            output,
            names,
            start,
            objective=objective,
            length=length,
            history=history,
            evaluations=evaluations,
            trials=trials,
            bounds=bounds,
            method=method,
            most_seconds=most_seconds,
            on_file=lambda done, of: move(done, of, "reading flights"),
            on_evaluation=lambda done, of: move(done, of or None, "evaluations" if of else f"{done} evaluations"),
            on_step=lambda step: move(0, None, f"{step.group} {'kept' if step.kept else 'not kept'}: {step.gain:+.4f} nats a row"),
        )
    for note in found.notes:
        print(f"note: {note}", file=sys.stderr)
    content = {
        "parameters": {
            name: {
                "value": estimate.value,
                "interval": list(estimate.interval),
                "trial_mean": estimate.trial_mean,
                "trial_deviation": estimate.trial_deviation,
                "spread": estimate.spread,
                "valley": estimate.valley,
            }
            for name, estimate in found.estimates.items()
        },
        "noise": found.noise,
        "bought": [dataclasses.asdict(step) for step in found.bought],
        "kind": found.kind,
        "objective": found.objective,
        "windows": found.windows,
        "evaluations": found.evaluations,
        "seconds": round(found.seconds, 3),
        "flights": _flights_content(flights),
        "notes": found.notes,
        "output": str(output),
    }

    def text() -> None:
        _print_flights(flights, found.windows)
        terminal.bought(found)
        terminal.estimates(found)
        print(f"objective {found.objective:.4g} after {found.evaluations} evaluations in {found.seconds:.1f} s; written to {output}")

    _emit(as_json, content, text)


def _times(_: click.Context, __: click.Parameter, given: str) -> list[float]:
    try:
        return [float(entry) for entry in given.split(",")]
    except ValueError as error:
        raise click.BadParameter(f"{given!r}; expected seconds, such as 0.1,0.25,0.5.") from error


@commands.command()
@click.argument("drone_", metavar="DRONE")
@click.argument("logs", type=click.Path(path_type=Path))
@_output("validation.csv", "CSV file for the errors and their intervals.")
@click.option("--horizons", default="0.1,0.25,0.5", show_default=True, callback=_times, help="How far ahead to predict, seconds.")
@_seed
@_as_json
@_overwrite
def validate(drone_: str, logs: Path, output: Path, horizons: list[float], seed: int, as_json: bool, overwrite: bool) -> None:
    """Validate a DRONE on LOGS that it was not identified from.

    DRONE is a TOML file or a name, LOGS a flight log or a folder of them. From every tenth row the drone is simulated with the
    recorded commands alone; the table tells how far it is from the flight then. Beside it stand the paper's Crazyflie and the
    prediction that nothing changes: position, velocity, attitude and body rates stay as they are.
    """
    _must_be_new(output, overwrite)
    _must_be_new(output.with_name(f"{output.stem}_windows.csv"), overwrite)
    from maidenflight import workflow

    with terminal.progress("validate", None) as move:
        flights, errors, notes = workflow.validate_with(
            drone_, logs, seed, output, horizons, lambda done, of: move(done, of, "reading flights")
        )
    for note in notes:
        print(f"note: {note}", file=sys.stderr)
    content = {
        "errors": errors.to_dicts(),
        "flights": _flights_content(flights),
        "simulated": any(flight.simulated for flight in flights),
        "notes": notes,
        "output": str(output),
    }

    def text() -> None:
        _print_flights(flights, errors["windows"][0])
        terminal.predictions(errors, simulated=any(flight.simulated for flight in flights))
        print(f"written to {output} in SI units, with 95 % intervals over {errors['stretches'][0]} stretches of flight;")
        print(f"some windows row by row, for pictures, to {output.with_name(f'{output.stem}_windows.csv')}")

    _emit(as_json, content, text)


def _randomization(*words: str) -> Callable[[click.Context, click.Parameter, str | None], float | str | None]:
    """Reads a half width or one of the words."""

    def read(_: click.Context, __: click.Parameter, given: str | None) -> float | str | None:
        if given is None or given in words:
            return given
        try:
            width = float(given)
        except ValueError:
            width = -1.0
        if not 0.0 <= width <= 0.9:
            raise click.BadParameter(f"{given!r}; expected a number from 0 to 0.9, or {' or '.join(words)}.")
        return width

    return read


@commands.command()
@click.option("--drone", "drone_", default="drone.toml", show_default=True, help="Drone to train for: a TOML file or a name.")
@_output("policies", "Folder for the policies.")
@click.option(
    "--control", default="pwm", show_default=True, type=click.Choice(["pwm", "attitude_rate", "attitude"]), help="Control structure."
)
@click.option("--task", default="circle", show_default=True, type=click.Choice(_TASKS), help="Task.")
@click.option("--policies", "count", default=3, show_default=True, type=click.IntRange(1, 64), help="How many, each from its own seed.")
@click.option("--history", default=2, show_default=True, type=click.IntRange(1, 50), help="Instants that a policy sees: the last so many.")
@click.option("--method", default="gradient", show_default=True, type=click.Choice(["gradient", "ppo"]), help="How policies learn.")
@click.option(
    "--updates",
    type=click.IntRange(1, 10**6),
    help="Gradient steps, or epochs of PPO; as many as the control structure needs unless given.",
)
@click.option(
    "--randomize",
    default="0.1",
    show_default=True,
    callback=_randomization("posterior", "wide"),
    help="Half width of the parameters' box; posterior: the drones that the identified flights leave possible; or wide: drones unlike it"
    " too, with all the constant torques that its flights had.",
)
@click.option(
    "--heading",
    default=0.0,
    show_default=True,
    type=_Range(0.0, 10.0),
    help="Price of a radian of heading, a control period; 0.1 keeps a drone from turning away in long flights, of which the paper's reward"
    " says nothing.",
)
@click.option("--resume", is_flag=True, help="Go on with training that was interrupted in the folder, with the same result.")
@click.option(
    "--log",
    "boards",
    multiple=True,
    type=click.Choice(list(BOARDS)),
    help="Show scores there too, as they come: event files in OUTPUT/tensorboard, or Weights & Biases. May be repeated.",
)
@click.option(
    "--view",
    is_flag=False,
    flag_value="",
    metavar="[FILE]",
    help="Show scores and how the best policy flies while training runs: in rerun's viewer, or into an .rrd FILE for it.",
)
@_seed
@_as_json
@_overwrite
def train(
    drone_: str,
    output: Path,
    control: str,
    task: str,
    count: int,
    history: int,
    method: str,
    updates: int | None,
    randomize: float | str,
    heading: float,
    resume: bool,
    boards: tuple[str, ...],
    view: str | None,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Train policies around a drone, by gradients through the simulator or by PPO.

    Interrupted, by Ctrl-C or anything else, it loses at most what it learned since the last score: give the same command with --resume.
    """
    _must_be_new(output, overwrite or resume, "go on with what was interrupted there by --resume")
    cores.as_devices()
    from maidenflight import workflow

    settings = workflow.settings_for(control, task, method, updates)
    heard: list[Progress] = []
    began = time.perf_counter()
    with (
        _watched(view, drone_, control, task) as watch,
        terminal.progress("train", settings.updates) as move,
        _resumable(output / workflow.CHECKPOINT),
    ):

        def hear(progress: "Progress") -> None:
            nonlocal began
            # The first score comes after compiling, and those of a resumed training come at once.
            rate = (progress.steps - heard[0].steps) / (time.perf_counter() - began) if heard else None
            began = began if heard else time.perf_counter()
            heard.append(progress)
            move(progress.update, settings.updates, terminal.scores(progress, rate))
            watch(progress)

        workflow.train_for(drone_, seed, output, count, settings, randomize, hear, control, task, resume, boards, history, heading)
    best = [max((progress.score for progress in heard), key=lambda score: float(score.episode_return[number])) for number in range(count)]
    scores = [{name: round(float(value[number]), 6) for name, value in score._asdict().items()} for number, score in enumerate(best)]
    content = {"policies": [str(output / f"policy_{number}.json") for number in range(1, count + 1)], "scores": scores}

    def text() -> None:
        rows = [
            [f"policy_{number}", f"{score['episode_return']:.1f}", f"{score['survival']:.1%}", f"{score['position_error'] * 100:.1f} cm"]
            for number, score in enumerate(scores, 1)
        ]
        terminal.table("Trained policies", ["policy", "return", "survival", "position error"], rows)
        print(f"written to {output}/")

    _emit(as_json, content, text)


@contextmanager
def _watched(view: str | None, drone_: str, control: str, task: str) -> Iterator[Callable[["Progress"], None]]:
    """What shows each score of a training in rerun; nothing unless asked for."""
    if view is None:
        yield lambda progress: None
        return
    from maidenflight import workflow
    from maidenflight.reporting import live

    with live.training(workflow.watched_flight(drone_, control, task), Path(view) if view else None) as watch:
        yield watch


@commands.command()
@click.argument("policies", nargs=-1, type=click.Path(path_type=Path))
@_output("transfer", "Folder for the flights.")
@click.option("--reality", "realities", multiple=True, help=f"Where: {_REALITIES}; may be repeated (virtual:7 unless given).")
@click.option("--task", type=click.Choice(_TASKS), help="What they fly (circle unless given).")
@click.option("--trials", type=click.IntRange(1, 1000), help="Flights of each policy in each reality (3 unless given).")
@click.option("--duration", type=_Range(0.1, 600.0), help="Longest flight, seconds (20 unless given).")
@click.option(
    "--matrix",
    "settings",
    type=click.Path(path_type=Path),
    help="Train policies for many drones first and fly those: a TOML file such as paper/zero_shot.toml, which says all the rest.",
)
@click.option("--resume", is_flag=True, help="Go on with a matrix that was interrupted in the folder, with the same result.")
@click.option("--seed", type=int, help="Random seed; the same seed gives the same results (0 unless given).")
@_as_json
@_overwrite
def transfer(
    policies: tuple[Path, ...],
    output: Path,
    realities: tuple[str, ...],
    task: str | None,
    trials: int | None,
    duration: float | None,
    settings: Path | None,
    resume: bool,
    seed: int | None,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Fly POLICIES (files or folders), or those of a matrix, in realities that they have not seen; all of it simulated.

    Policies are ours, or the authors' in files whose names begin with a control structure; all of one call are of one kind.
    """
    if settings is not None:
        if policies or realities or any(given is not None for given in (task, trials, duration, seed)):
            raise click.UsageError(f"{settings} says which policies fly, where and how. Give --matrix alone, with -o.")
        _transfer_matrix(settings, output, resume, overwrite, as_json)
        return
    if not policies or resume:
        raise click.UsageError("Only a matrix is resumed." if policies else "Give policies (files or folders), or --matrix.")
    _must_be_new(output, overwrite)
    from maidenflight import workflow

    with terminal.progress("transfer", None):
        places = [workflow.reality(name) for name in realities or ("virtual:7",)]
        flown = workflow.transfer_to(policies, places, seed or 0, output, trials or 3, duration or 20.0, task or "circle")
    content = {"flights": flown.table.to_dicts(), "simulated": True, "output": str(output)}

    def text() -> None:
        terminal.flights(flown)
        print(f"written to {output}/")

    _emit(as_json, content, text)


def _transfer_matrix(settings: Path, output: Path, resume: bool, overwrite: bool, as_json: bool) -> None:
    _must_be_new(output, overwrite or resume, "go on with what was interrupted there by --resume")
    cores.as_devices()
    from maidenflight import workflow
    from maidenflight.experiments import matrix

    asked = matrix.read(settings)
    with terminal.progress("transfer", len(asked.cells)) as move, _resumable(output / workflow.CELLS):
        flights = workflow.transfer_matrix(asked, output, move, anew=overwrite and not resume)
    cells = matrix.by_cell(flights, asked.duration)

    def text() -> None:
        terminal.cells(cells)
        print(f"{flights.height} simulated flights of {len(asked.cells) * asked.policies} policies, written to {output}/flights.csv")

    _emit(as_json, {"flights": flights.to_dicts(), "cells": cells.to_dicts(), "simulated": True, "output": str(output)}, text)


@commands.command()
@click.argument("policies", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--drone", "drone_", default="drone.toml", show_default=True, help="Identified drone: a TOML file or a name.")
@_output("prediction.csv", "CSV file for the flights, one row each.")
@click.option("--trials", default=16, show_default=True, type=click.IntRange(1, 1000), help="Flights of each policy.")
@click.option("--duration", default=20.0, show_default=True, type=_Range(0.1, 600.0), help="Longest flight, seconds.")
@click.option(
    "--randomize",
    callback=_randomization("trim", "posterior"),
    help="trim: constant torques differ as between the identified flights, the default where the drone's file tells how; posterior: drones"
    " that those flights leave possible; or the half width of the parameters' box, 0 for the drone as it is.",
)
@click.option(
    "--control",
    type=click.Choice(["pwm", "attitude_rate", "attitude"]),
    help="What the authors' policies command; unless given, what their files' names begin with or their folder is called. Ours say it.",
)
@click.option(
    "--firmware",
    default="2021.10",
    show_default=True,
    type=click.Choice(["2021.10", "2026.08"]),
    help="2021.10 as the authors' drone ran it, or 2026.08, for which attitude-rate and attitude policies of ours are trained.",
)
@_seed
@_as_json
@_overwrite
def predict(
    policies: tuple[Path, ...],
    drone_: str,
    output: Path,
    trials: int,
    duration: float,
    randomize: float | str | None,
    control: str | None,
    firmware: str,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Predict how long POLICIES (files or folders) would fly on the real drone.

    Policies of maidenflight and of Gronauer et al., of all control structures together, fly the circle on the identified drone as the
    authors' drone ran them: at their rate, by its firmware, from hover, until a guard trips. All of it is simulated.
    """
    _must_be_new(output, overwrite)
    cores.as_devices()
    from maidenflight import workflow

    with terminal.progress("predict", None) as move:
        files, flown = workflow.predict_with(
            drone_,
            policies,
            seed,
            output,
            trials=trials,
            duration=duration,
            randomization=randomize,
            structure=control,
            firmware=firmware,
            on_policy=lambda done, of: move(done, of, "policies flown"),
        )

    def text() -> None:
        terminal.flight_times(flown)
        print(f"written to {output}")

    _emit(as_json, {"policies": _flight_times_content(files, flown), "simulated": True, "output": str(output)}, text)


def _flight_times_content(files: list[Path], flown: "DataFrame") -> list[dict[str, Any]]:
    from maidenflight.experiments.flight_times import QUANTILES, summary

    parts = flown.partition_by("policy", maintain_order=True)
    return [
        {
            "file": str(file),
            "control": row["control"],
            "mean_duration": round(row["mean"], 6),
            "quantiles": {f"{percent / 100:g}": round(row[f"quantile_{percent}"], 6) for percent in QUANTILES},
            "end_reasons": dict(Counter(part["end_reason"].to_list()).most_common()),
        }
        for file, row, part in zip(files, summary(flown).iter_rows(named=True), parts, strict=True)
    ]


_EXPORTED = {"c": "firmware", "onnx": "onnx_policy", "authors": "authors_policy", "crazyflie": "crazyflie_app"}
"""Folders of what a policy is exported to."""


@commands.command()
@click.argument("policy", type=click.Path(path_type=Path))
@click.option(
    "--to",
    default="c",
    show_default=True,
    type=click.Choice(list(_EXPORTED)),
    help="c: C99 without dependencies, policy.h and policy.c; onnx: policy.onnx; authors: a JSON as the tools of Gronauer et al. read it;"
    " crazyflie: an app that builds beside an unmodified Crazyflie firmware.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help=f"Folder; {', '.join(f'{folder} for {to}' for to, folder in _EXPORTED.items())} unless given.",
)
@click.option(
    "--control",
    type=click.Choice(["pwm", "attitude_rate", "attitude"]),
    help="What an authors' policy commands; unless given, what its file's name begins with or its folder is called. Ours say it.",
)
@_seed
@_as_json
@_overwrite
def export(policy: Path, to: str, output: Path | None, control: str | None, seed: int, as_json: bool, overwrite: bool) -> None:
    """Export a POLICY file, ours or of Gronauer et al., to C, to ONNX, to their JSON or as an app for the Crazyflie."""
    output = output or Path(_EXPORTED[to])
    _must_be_new(output, overwrite)
    from maidenflight import workflow

    written = workflow.export(policy, output, seed, to, control)
    content = {"files": [str(path) for path in written]}
    _emit(as_json, content, lambda: print("written " + ", ".join(map(str, written))))


_REPORT = b"<footer>Written by maidenflight "
"""What every report holds."""


@commands.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="HTML file; report.html in the folder unless given.")
@_as_json
@click.option("--overwrite", is_flag=True, help="Replace a file that is no report; an earlier report is replaced anyway.")
def report(run: Path, output: Path | None, as_json: bool, overwrite: bool) -> None:
    """Make one self-contained HTML page of a RUN folder."""
    output = output or run / "report.html"
    with suppress(OSError):
        overwrite = overwrite or (output.is_file() and _REPORT in output.read_bytes())
    _must_be_new(output, overwrite)
    from maidenflight.reporting.page import report as make

    page = make(run, output)
    _emit(as_json, {"report": str(page)}, lambda: print(f"written {page}"))


@commands.command()
@click.argument("flights", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="An .rrd file for rerun; its viewer is started unless given.")
@_as_json
@_overwrite
def view(flights: Path, output: Path | None, as_json: bool, overwrite: bool) -> None:
    """View FLIGHTS in rerun: a log, a folder of logs or a run folder. Needs pip install 'maidenflight[viewer]'."""
    if output is not None:
        _must_be_new(output, overwrite)
    from maidenflight import workflow
    from maidenflight.reporting import live

    shown = workflow.flights_to_view(flights)
    live.show_flights(shown, output)
    content = {"flights": len(shown), "file": str(output) if output else None}
    _emit(as_json, content, lambda: print(f"{len(shown)} flights {f'written to {output}' if output else 'sent to the viewer'}"))


@commands.command()
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder; the first free of run, run-2, ... unless given.")
@click.option("--seed", default=7, show_default=True, help="Random seed, also of the virtual drone.")
@_as_json
@_overwrite
def demo(output: Path | None, seed: int, as_json: bool, overwrite: bool) -> None:
    """Run the whole line on a virtual drone in about three minutes: record, identify, train, fly unseen, export, report."""
    if output is None:
        output = next(path for number in range(1, 10**6) if not (path := Path("run" if number == 1 else f"run-{number}")).exists())
    else:
        _must_be_new(output, overwrite)
    cores.as_devices()
    from maidenflight.demo import Listener, Plan
    from maidenflight.demo import demo as run

    plan = Plan()
    what = {
        "record": f"{plan.flights} flights of {plan.duration:g} s on a virtual drone (simulated), flown by the firmware's PID",
        "identify": "motors, delays and whatever else these flights can tell",
        "train": f"{plan.policies} policies by gradients through the simulator",
        "transfer": f"{plan.policies * plan.flight_trials} zero-shot flights in the virtual reality they have not seen",
        "export": "the best policy to C99",
        "report": "one page to look at",
    }
    with terminal.progress("demo", None) as move:

        def begin(name: str) -> None:
            print(f"{name:<9} {what[name]}", file=sys.stderr, flush=True)
            move(0, None, f"{name}: compiling and running")

        result = run(
            output,
            seed,
            plan,
            Listener(
                stage=begin,
                evaluation=lambda done, of: move(done, of or None, f"identify: {done} evaluations"),
                training=lambda progress: move(progress.update, plan.learner.updates, f"train: {terminal.scores(progress)}"),
            ),
        )
    _emit(as_json, _demo_content(result), lambda: terminal.summary(result))


def _demo_content(result: "Demo") -> dict[str, Any]:
    return {
        "parameters": {
            name: {"value": estimate.value, "interval": list(estimate.interval)}
            for name, estimate in result.identification.estimates.items()
        },
        "truth": terminal.truth(result),
        "flights": result.transfer.table.to_dicts(),
        "stages": result.seconds,
        "report": str(result.page),
        "simulated": True,
    }


if __name__ == "__main__":
    main()
