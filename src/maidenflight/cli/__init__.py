"""The command line: verbs as commands, their errors, and Ctrl-C. `--help` imports nothing heavy."""

import io
import sys

import click

from maidenflight import __version__, terminal
from maidenflight.cli import interruption
from maidenflight.cli.command import Commands
from maidenflight.errors import InputError

_CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


@click.group(cls=Commands, context_settings=_CONTEXT)
@click.version_option(__version__, prog_name="maidenflight")
def commands() -> None:
    """Takes flight logs of a quadrotor to a neural network that is to fly it.

    \b
    flight logs -> identify -> validate -> train -> transfer -> export -> report
    """  # noqa: D301


def main(*, in_own_process: bool = False) -> None:
    """Runs a command: exit code 2 and one line for a user's mistake, 130 when interrupted.

    Args:
        in_own_process: see `interruption.handle_sigint`.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # Of terminals in Latin-1, and of names that are no UTF-8.
            stream.reconfigure(errors="backslashreplace")
    try:
        with interruption.handle_sigint(in_own_process=in_own_process):
            commands(prog_name="maidenflight", standalone_mode=False)
    except InputError as error:
        _complain(str(error))
        sys.exit(2)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(error.exit_code)
    except click.ClickException as error:
        _complain(_one_line(error))
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        _complain(interruption.line())
        sys.exit(interruption.CODE)


def _complain(text: str) -> None:
    print(terminal.lay_out(f"maidenflight: {text}", sys.stderr), file=sys.stderr)


def _one_line(error: click.ClickException) -> str:
    """Returns what was wrong with a command's options, and where they are explained."""
    message = " ".join(error.format_message().split())
    context = error.ctx if isinstance(error, click.UsageError) else None
    return message if context is None else f"{message} Options: {context.command_path} --help."
