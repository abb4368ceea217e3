"""The process of a command: `maidenflight`, or `python -m maidenflight`."""

import os
import signal
import sys


def main() -> None:
    """Runs the command line; once it has reported its end, Ctrl-C changes nothing.

    A process that was interrupted leaves at once, since Python's own end would crash where threads
    of XLA are still compiling.
    """
    # Processes that a command starts look for modules where this one does, not in the folder in
    # which the user happens to be, which may be anybody's.
    os.environ.setdefault("PYTHONSAFEPATH", "1")
    try:
        from maidenflight import cli
        from maidenflight.cli import interruption
    except KeyboardInterrupt:
        print("maidenflight: interrupted before it had begun.", file=sys.stderr)
        sys.exit(130)
    try:
        cli.main(in_own_process=True)
    except SystemExit as leaving:
        if leaving.code == interruption.CODE:
            interruption.leave(interruption.CODE)
        raise
    except KeyboardInterrupt:
        print(f"maidenflight: {interruption.line()}", file=sys.stderr)
        interruption.leave(interruption.CODE)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


if __name__ == "__main__":
    main()
