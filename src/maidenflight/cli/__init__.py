"""The command line: parsing only. Nothing heavy is imported before a command runs.

Its modules stand in the order of the flow: record, identify, train, transfer, export; demo is the
whole of it.
"""

import gc
import sys

import click

from maidenflight import __version__, cache, compiler
from maidenflight.cli import (
    demo,
    drone,
    envelope,
    export,
    identify,
    interruption,
    log,
    plan,
    plant,
    record,
    sweep,
    train,
    transfer,
    validate,
)
from maidenflight.errors import InputError

_CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


def main(patience: float | None = None) -> None:
    """Runs a command: exit code 2 and one line for a user's mistake, 130 when interrupted.

    Args:
        patience: see `interruption.insisting`.
    """
    try:
        with interruption.insisting(patience):
            compiler.set_flags(compiler.QUICK)
            cache.keep_compiled()
            # JAX traces a program in some hundred thousand objects, and to look for cycles among
            # them as often as Python does by itself takes a fifth of the time.
            gc.set_threshold(100_000)
            commands(prog_name="maidenflight", standalone_mode=False)
    except InputError as error:
        print(f"maidenflight: {error}", file=sys.stderr)
        sys.exit(2)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(error.exit_code)
    except click.ClickException as error:
        print(f"maidenflight: {_in_one_line(error)}", file=sys.stderr)
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        print(f"maidenflight: {interruption.line()}", file=sys.stderr)
        sys.exit(interruption.CODE)


def _in_one_line(error: click.ClickException) -> str:
    """What was wrong with a command's options, and where they are explained."""
    said = " ".join(error.format_message().split())
    context = error.ctx if isinstance(error, click.UsageError) else None
    return said if context is None else f"{said} Options: {context.command_path} --help."


@click.group(context_settings=_CONTEXT)
@click.version_option(__version__, prog_name="maidenflight")
def commands() -> None:
    """From flight logs to a neural network that flies the real drone on its first try.

    \b
    flight logs -> identify -> validate -> train -> transfer -> export -> report
    """  # noqa: D301


for _command in (
    log.log,
    plan.plan,
    record.record,
    record.fly,
    drone.drone,
    identify.identify,
    validate.validate,
    train.train,
    transfer.transfer,
    transfer.predict,
    envelope.envelope,
    sweep.sweep,
    export.export,
    export.report,
    export.view,
    plant.plant,
    demo.demo,
):
    commands.add_command(_command)
