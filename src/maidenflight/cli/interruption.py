"""Handling of Ctrl-C: none is lost, and interrupted work says how to resume."""

import _thread
import shlex
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from maidenflight.errors import InputError, WriteError

if TYPE_CHECKING:
    from types import FrameType


@contextmanager
def insisting() -> Iterator[None]:
    """Holds on to a Ctrl-C that Python would lose.

    One that falls into a callback of the garbage collector, JAX's or another, is dropped there, and
    is sent again. One that falls into the start of an extension module comes out as that module's
    ImportError, and is taken for what it was.
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
    own = (
        signal.getsignal(signal.SIGINT) is signal.default_int_handler
        and threading.current_thread() is threading.main_thread()
    )
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


@contextmanager
def resumable(checkpoint: Path) -> Iterator[None]:
    """Says how to go on where work is interrupted that a checkpoint, a file or a folder, holds.

    Or that it holds nothing yet.
    """
    again = shlex.join(
        [
            "maidenflight",
            *(argument for argument in sys.argv[1:] if argument not in ("--resume", "--overwrite")),
            "--resume",
        ]
    )
    try:
        yield
    except KeyboardInterrupt:
        if not checkpoint.exists():
            again_from_start = shlex.join(["maidenflight", *sys.argv[1:]])
            print(
                "maidenflight: interrupted before anything was reached. Start again with: "
                f"{again_from_start}",
                file=sys.stderr,
            )
            sys.exit(130)
        print(
            f"maidenflight: interrupted; {checkpoint} holds what was reached. Go on with: {again}",
            file=sys.stderr,
        )
        sys.exit(130)
    except WriteError as error:
        if not checkpoint.exists():
            raise
        raise InputError(
            f"{error.wrong} {checkpoint} holds what was reached. {error.remedy} and go on with: "
            f"{again}"
        ) from error
