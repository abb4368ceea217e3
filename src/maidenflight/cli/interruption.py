"""Handling of Ctrl-C: none is lost, every one ends the process, and says how to resume.

The main thread raises KeyboardInterrupt as soon as it runs Python again, which a compilation of XLA
delays by seconds. An import is not unwound but ends the process at once, since extension modules
print, hide or crash over what is raised in their midst. Files are written whole or not at all, so
no moment is wrong.
"""

import _thread
import os
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from maidenflight.errors import InputError, WriteError

if TYPE_CHECKING:
    from types import FrameType

CODE = 130
"""Exit code of an interrupted command: 128 and the number of SIGINT, as of a shell."""


def plainly() -> str:
    """Returns the line of an interrupted command that has nothing to resume."""
    return "interrupted; finished files are complete, the rest was not written."


_line: Callable[[], str] = plainly


def line() -> str:
    """Returns what the command that was interrupted says."""
    return _line()


def leave(code: int) -> NoReturn:
    """Ends the process without what Python does at its end.

    Threads of XLA may still be compiling, and crash an interpreter that is being taken down. Pools
    of processes give back their semaphores, or their tracker's warning would be the last words.
    """
    if processes := sys.modules.get("multiprocessing.util"):
        processes._run_finalizers(0)
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def _end() -> NoReturn:
    if sys.stderr.isatty():
        print("\x1b[?25h", file=sys.stderr)  # a progress bar hides the cursor
    print(f"maidenflight: {line()}", file=sys.stderr)
    leave(CODE)


def _importing(frame: "FrameType | None") -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


@contextmanager
def handle_sigint(*, in_own_process: bool = False) -> Iterator[None]:
    """Holds on to a Ctrl-C that Python would lose.

    One that falls into a callback of the garbage collector, JAX's or another, is dropped there, and
    is sent again. One that falls into the start of an extension module comes out as that module's
    ImportError, and is taken for what it was.

    Args:
        in_own_process: whether the process is the command's, which one in an import then ends.
    """
    global _line
    _line = plainly
    before, interrupted = sys.unraisablehook, False

    def dropped(what: "sys.UnraisableHookArgs") -> None:
        if not issubclass(what.exc_type, KeyboardInterrupt):
            before(what)
            return
        again = threading.Timer(0.05, _thread.interrupt_main)
        again.daemon = True
        again.start()

    def handle_signal(number: int, frame: "FrameType | None") -> None:
        nonlocal interrupted
        interrupted = True
        if in_own_process and _importing(frame):
            _end()
        signal.default_int_handler(number, frame)

    sys.unraisablehook = dropped
    try:
        with _handled(handle_signal):
            yield
    except ImportError as error:
        if interrupted:
            raise KeyboardInterrupt from error
        raise
    finally:
        sys.unraisablehook = before


@contextmanager
def _handled(handler: Callable[[int, "FrameType | None"], None]) -> Iterator[None]:
    """Handles SIGINT by a function that raises, except where somebody else does."""
    if (
        signal.getsignal(signal.SIGINT) is not signal.default_int_handler
        or threading.current_thread() is not threading.main_thread()
    ):
        yield
        return
    signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _written(file: Path) -> tuple[int, int] | None:
    """What tells a file from the one that replaces it; nothing of a folder, or of no file."""
    if not file.is_file():
        return None
    status = file.stat()
    return status.st_ino, status.st_mtime_ns


@contextmanager
def resumable(checkpoint: Path | None, again: str = "--resume") -> Iterator[None]:
    """Says how to go on where work is interrupted that a checkpoint, a file or a folder, holds.

    Or that it holds nothing yet: a file may be that of an earlier run, which this one replaces.

    Args:
        checkpoint: as above; None: there is nothing to go on from.
        again: option by which the command goes on; nothing for one that always does.
    """
    global _line
    if checkpoint is None:
        yield
        return
    earlier = None if "--resume" in sys.argv else _written(checkpoint)

    def reached() -> bool:
        return checkpoint.exists() and (earlier is None or _written(checkpoint) != earlier)

    arguments = [word for word in sys.argv[1:] if word not in ("--resume", "--overwrite")]
    command = shlex.join(["maidenflight", *arguments, *([again] if again else [])])

    def how() -> str:
        if reached():
            return f"interrupted; {checkpoint} holds what was reached. Go on with: {command}"
        from_start = shlex.join(["maidenflight", *sys.argv[1:]])
        return f"interrupted before anything was reached. Start again with: {from_start}"

    _line = how
    try:
        yield
        _line = plainly
    except WriteError as error:
        if not reached():
            raise
        raise InputError(
            f"{error.wrong} {checkpoint} holds what was reached. {error.remedy} and go on with: "
            f"{command}"
        ) from error
