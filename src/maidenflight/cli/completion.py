"""Installs the Tab key's completion of commands, options and values in a shell."""

import os
from pathlib import Path
from typing import NamedTuple

import click

from maidenflight.errors import InputError


class Shell(NamedTuple):
    """Where a shell reads what it does at its start, and the line that completes commands."""

    file: str
    """Below the home folder."""
    line: str


# Source: Click's documentation, "Shell Completion".
SHELLS = {
    "bash": Shell(".bashrc", 'eval "$(_MAIDENFLIGHT_COMPLETE=bash_source maidenflight)"'),
    "zsh": Shell(".zshrc", 'eval "$(_MAIDENFLIGHT_COMPLETE=zsh_source maidenflight)"'),
    "fish": Shell(
        ".config/fish/completions/maidenflight.fish",
        "_MAIDENFLIGHT_COMPLETE=fish_source maidenflight | source",
    ),
}


def install(shell: str | None = None) -> Path:
    """Adds the line to a shell's file, once.

    Args:
        shell: one of `SHELLS`; by default that of the user, as `$SHELL` says.

    Returns:
        The file.

    Raises:
        InputError: another shell, or the file cannot be written.
    """
    name = shell or Path(os.environ.get("SHELL", "")).name
    if name not in SHELLS:
        raise InputError(
            f"--install-completion: shell {name!r} is not known. Give one of {', '.join(SHELLS)}."
        )
    file, line = Path.home() / SHELLS[name].file, SHELLS[name].line
    try:
        text = file.read_text() if file.exists() else ""
        if line not in text.splitlines():
            file.parent.mkdir(parents=True, exist_ok=True)
            with file.open("a") as place:
                place.write(f"{'' if text.endswith(chr(10)) or not text else chr(10)}{line}\n")
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror}). Add {line!r}.") from error
    return file


def option() -> click.Option:
    """Returns the option that installs it and ends."""

    def use(context: click.Context, _: click.Parameter, shell: str | None) -> None:
        if shell is None or context.resilient_parsing:
            return
        click.echo(
            f"{install(shell or None)}: Tab completes maidenflight in shells opened from now on"
        )
        context.exit()

    return click.Option(
        ["--install-completion"],
        metavar=f"[{'|'.join(SHELLS)}]",
        is_flag=False,
        flag_value="",
        expose_value=False,
        is_eager=True,
        callback=use,
        help="Let the Tab key complete commands and options; your shell by default.",
    )
