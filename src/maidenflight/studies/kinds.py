"""What a task of a study may be: its settings, and the function that does it.

Those of maidenflight are the verbs of the command line. One of your own is a `Kind` in a module
that every machine can import; a study names it `MODULE:NAME`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from maidenflight.errors import InputError
from maidenflight.inputs import is_number

Row = dict[str, Any]
"""A row of a study's table: numbers and texts by column."""
REQUIRED = object()
"""The default of a setting that must be given."""


@dataclass(frozen=True)
class Setting:
    """A setting of a kind of task."""

    expected: str
    """What it is, for the error of another value."""
    fits: Callable[[Any], bool]
    """Whether a value is possible."""
    default: Any = REQUIRED
    """Its value unless given."""
    files: bool = False
    """Whether the value names files or folders, or may; their content then names the result."""


@dataclass(frozen=True)
class Work:
    """What a task's function is given."""

    settings: Mapping[str, Any]
    """All settings; what another task makes is the path of it."""
    folder: Path
    """Where to write files. It is empty, and is seen by others only once the task has ended."""
    cpus: int
    """Cores that the task may use."""


def _nothing(settings: Mapping[str, Any]) -> None:
    """Finds nothing wrong."""


@dataclass(frozen=True)
class Kind:
    """A kind of task."""

    run: Callable[[Work], Sequence[Row]]
    """Does it, and returns its rows of the study's table. Equal settings must give equal rows: a
    result is computed once."""
    settings: Mapping[str, Setting] = field(default_factory=dict)
    product: str = ""
    """The file in a task's folder that later tasks take; the folder itself unless given."""
    takes: Mapping[str, str] = field(default_factory=dict)
    """Settings that another task may make, and the kind of that task."""
    check: Callable[[Mapping[str, Any]], None] = _nothing
    """Raises InputError where settings given do not go together or name what is not there; called
    before the first task runs, without the settings that other tasks make."""
    version: str = ""
    """Of a kind of your own; results of another version are computed again."""
    counts: str = ""
    """The setting that says how many policies the task trains."""


def whole(low: int, high: int, default: Any = REQUIRED) -> Setting:
    """A whole number within two others."""
    return Setting(
        f"a whole number from {low} to {high}",
        lambda value: type(value) is int and low <= value <= high,
        default,
    )


def number(low: float, high: float, default: Any = REQUIRED) -> Setting:
    """A number within two others."""
    return Setting(
        f"a number from {low:g} to {high:g}",
        lambda value: is_number(value) and low <= value <= high,
        default,
    )


def choice(known: Sequence[str], default: Any = REQUIRED) -> Setting:
    """One of some texts."""
    return Setting(" or ".join(known), lambda value: value in known, default)


def text(expected: str, default: Any = REQUIRED, files: bool = False) -> Setting:
    """A text."""
    return Setting(expected, lambda value: isinstance(value, str) and value != "", default, files)


def texts(expected: str, default: Any = REQUIRED, files: bool = False) -> Setting:
    """A list of texts."""
    return Setting(
        f"a list of {expected}",
        lambda value: (
            isinstance(value, list)
            and bool(value)
            and all(isinstance(one, str) and one for one in value)
        ),
        default,
        files,
    )


def flag(default: bool = False) -> Setting:
    """True or false."""
    return Setting("true or false", lambda value: isinstance(value, bool), default)


def optional(setting: Setting) -> Setting:
    """The same setting, which may be left out."""
    return Setting(setting.expected, setting.fits, None, setting.files)


def _width_or(*words: str) -> Setting:
    def fits(value: Any) -> bool:
        return value in words if isinstance(value, str) else is_number(value) and 0 <= value <= 0.9

    return optional(Setting(f"{', '.join(words)} or a half width from 0 to 0.9", fits))


CONTROLS = ("pwm", "attitude_rate", "attitude")
TASKS = ("circle", "figure_eight", "fast_circle", "fast_figure_eight", "hover", "take_off")
AXES = ("circle", "figure_eight", "gusts", "payload", "battery", "propeller", "latency")
FIRMWARES = ("2021.10", "2026.08")

_SEED = whole(0, 2**31 - 1, 0)
_DRONE = text("a drone's name or TOML file", files=True)
_POLICIES = texts("policy files and folders", files=True)
_LAYERS = Setting(
    "a list of whole numbers from 1 to 1024",
    lambda value: (
        isinstance(value, list)
        and bool(value)
        and all(type(one) is int and 1 <= one <= 1024 for one in value)
    ),
)
_REALITIES = texts("realities, as transfer takes", files=True)


def _verb(name: str, *arguments: Any) -> Any:
    """Calls a function of `verbs`, which imports JAX."""
    from maidenflight.studies import verbs

    return getattr(verbs, name)(*arguments)


KINDS: dict[str, Kind] = {
    "identify": Kind(
        partial(_verb, "identify"),
        {
            "logs": text("a flight log or a folder of them", files=True),
            "start": text("a drone's name or TOML file", "crazyflie", files=True),
            "mass": optional(number(5.0, 5000.0)),
            "over": optional(
                Setting(
                    "auto or a list of parameters",
                    lambda value: value == "auto" or texts("").fits(value),
                )
            ),
            "evaluations": whole(11, 2000, 60),
            "trials": whole(1, 100, 2),
            "most_seconds": number(10.0, 1e6, 3600.0),
            "seed": _SEED,
        },
        product="drone.toml",
        check=partial(_verb, "check_identify"),
    ),
    "train": Kind(
        partial(_verb, "train"),
        {
            "drone": _DRONE,
            "control": choice(CONTROLS, "pwm"),
            "task": choice(TASKS, "circle"),
            "policies": whole(1, 4096, 3),
            "history": whole(1, 50, 2),
            "memory": whole(0, 256, 0),
            "hidden": optional(_LAYERS),
            "method": optional(choice(("gradient", "distillation", "ppo"))),
            "updates": optional(whole(1, 10**6)),
            "randomize": _width_or("posterior", "wide", "any-day", "any"),
            "yaw_penalty": number(0.0, 10.0, 0.0),
            "accept_bounds": flag(),
            "seed": _SEED,
        },
        product="policies",
        takes={"drone": "identify"},
        check=partial(_verb, "check_train"),
        counts="policies",
    ),
    "transfer": Kind(
        partial(_verb, "transfer"),
        {
            "policies": _POLICIES,
            "realities": optional(_REALITIES),
            "drone": optional(_DRONE),
            "task": optional(choice(TASKS)),
            "trials": whole(1, 1000, 3),
            "duration": number(0.1, 600.0, 20.0),
            "accept_bounds": flag(),
            "seed": _SEED,
        },
        takes={"policies": "train", "drone": "identify"},
        check=partial(_verb, "check_flights"),
    ),
    "predict": Kind(
        partial(_verb, "predict"),
        {
            "policies": _POLICIES,
            "drone": _DRONE,
            "trials": whole(1, 1000, 16),
            "duration": number(0.1, 600.0, 20.0),
            "randomize": _width_or("trim", "posterior"),
            "control": optional(choice(CONTROLS)),
            "firmware": choice(FIRMWARES, "2021.10"),
            "accept_bounds": flag(),
            "seed": _SEED,
        },
        takes={"policies": "train", "drone": "identify"},
        check=partial(_verb, "check_flights"),
    ),
    "envelope": Kind(
        partial(_verb, "envelope"),
        {
            "policies": _POLICIES,
            "realities": optional(_REALITIES),
            "drone": optional(_DRONE),
            "along": Setting(
                f"a list of {', '.join(AXES)}",
                lambda value: texts("").fits(value) and set(value) <= set(AXES),
                ["circle", "figure_eight"],
            ),
            "flights": whole(1, 1000, 20),
            "accept_bounds": flag(),
            "seed": _SEED,
        },
        takes={"policies": "train", "drone": "identify"},
        check=partial(_verb, "check_flights"),
    ),
}
"""The kinds of maidenflight, by the names of their commands."""


def kind(name: str) -> Kind:
    """The kind of a name, of maidenflight or `MODULE:NAME`.

    Raises:
        InputError: there is no such kind.
    """
    if name in KINDS:
        return KINDS[name]
    module, mark, attribute = name.partition(":")
    if mark:
        try:
            found = getattr(import_module(module), attribute)
        except (ImportError, AttributeError, ValueError) as error:
            raise InputError(
                f"{name}: cannot be imported ({error}). Give MODULE:NAME of a Kind in a module "
                "that Python finds, as by PYTHONPATH, on every machine."
            ) from error
        if isinstance(found, Kind):
            return found
        raise InputError(f"{name}: is a {type(found).__name__}; expected a studies.kinds.Kind.")
    raise InputError(
        f"{name!r} is no kind of task. Expected {', '.join(KINDS)}, or MODULE:NAME of your own."
    )
