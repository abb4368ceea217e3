"""The exceptions that a user's mistake and a full disk raise, and checks that raise them."""

import errno
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from os import PathLike
from typing import Any

LONGEST = 1500
"""Characters of a message; what a file holds in a number's place may be a book."""
_UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""Controls of terminals and of the direction of writing, and bytes of names that are no UTF-8."""


def printable(text: str) -> str:
    """Replaces what would control a terminal by its code in hexadecimal digits."""
    return _UNPRINTABLE.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def first_few(entries: Sequence[str], between: str = ", ", most: int = 3) -> str:
    """Returns the first entries of a list, and how many more there are."""
    rest = len(entries) - most
    return between.join(entries[:most]) + (f" and {rest} more" if rest > 0 else "")


class InputError(ValueError):
    """Something that the user gave is wrong.

    The message says what is wrong (with the value), what is expected and what to do; the command
    line prints it on one line and exits with code 2. It is one line; of one that is too long the
    middle is left out.
    """

    def __init__(self, message: str) -> None:
        line = printable(" ".join(message.splitlines()))
        if len(line) > LONGEST:
            line = f"{line[: LONGEST - 400]} ... {line[-390:]}"
        super().__init__(line)


@contextmanager
def optional(package: str, extra: str, purpose: str, remark: str = "") -> Iterator[None]:
    """Imports an optional package, in a `with` statement.

    Args:
        package: what is imported.
        extra: the extra that brings it.
        purpose: what needs it.
        remark: on its installation.

    Raises:
        InputError: it is not installed.
    """
    try:
        yield
    except ImportError as error:
        missing = getattr(error, "name", None) or package
        raise InputError(
            f"{missing.partition('.')[0]} is not installed, but {purpose} needs it. In "
            f"maidenflight's source folder: pip install -e '.[{extra}]'{remark and f' ({remark})'}"
        ) from error


def imported(package: str, extra: str, purpose: str, remark: str = "") -> Any:
    """Returns an optional package; arguments and errors as of `optional`."""
    with optional(package, extra, purpose, remark):
        return import_module(package)


_EXTRAS = {
    **{"gymnasium": "gym", "PIL": "gym", "rosbags": "rosbag", "pyulog": "ulog"},
    **{"orangebox": "blackbox", "pymavlink": "ardupilot", "submitit": "slurm"},
    "foundation_policy": "raptor",
}
"""The extra that brings a package, where it has another name."""
_SIMULATORS = ("pybullet", "l2f", "crazyflow")
"""Realities by the packages that simulate them."""


def require_packages(*packages: str) -> None:
    """Ends a script, before it has begun, that needs packages which are not installed.

    Args:
        packages: what it imports, of the extras; one that is called as the extra, or as above.

    Raises:
        SystemExit: with a line that says which are lacking, and how to install them.
    """
    lacking = [package for package in packages if find_spec(package) is None]
    if lacking:
        extras = ",".join(dict.fromkeys(_EXTRAS.get(package, package) for package in lacking))
        raise SystemExit(f"Needs {', '.join(lacking)}: pip install -e '.[{extras}]'")


def require_simulators(realities: Iterable[str]) -> None:
    """Ends a script whose realities, such as `l2f:crazyflie`, need what is not installed.

    Raises:
        SystemExit: see `require_packages`.
    """
    kinds = (name.partition(":")[0] for name in realities)
    require_packages(*dict.fromkeys(kind for kind in kinds if kind in _SIMULATORS))


class WriteError(InputError):
    """A file cannot be written, as on a full disk; its former content stays."""

    def __init__(self, path: str | PathLike[str], error: OSError) -> None:
        self.wrong = f"{path}: cannot be written ({error.strerror})."
        """What is wrong, a sentence."""
        is_full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        self.remedy = "Free space there" if is_full else "Make that place writable"
        """What to do before the same is tried again; a sentence may go on after it."""
        super().__init__(f"{self.wrong} {self.remedy}, or choose another place with -o.")


def check_traced(name: str, function: Callable[..., Any], expected: str, *arguments: Any) -> Any:
    """Checks that JAX can trace a function of arrays that a user has written.

    Args:
        name: of the function, for errors.
        function: to be tried; nothing is computed.
        expected: what it takes and gives, for errors.
        arguments: arrays, or their shapes.

    Returns:
        The shapes of what it gives.

    Raises:
        InputError: it raises an error, or JAX cannot trace it.
    """
    import jax

    try:
        return jax.eval_shape(function, *arguments)
    except (TypeError, AttributeError, ValueError, IndexError, jax.errors.JAXTypeError) as error:
        raise InputError(
            f"{name} is not a function that JAX can trace: {type(error).__name__}: {error} Expected"
            f" {expected}, by functions of jax.numpy, without if."
        ) from error
