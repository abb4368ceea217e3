"""Commands of the command line, run in this process."""

import shlex
import sys
from collections.abc import Callable
from typing import Any

import pytest

import laid_out
from maidenflight import cli, terminal

Command = Callable[..., tuple[int, str, str]]
"""Of words to exit code, standard output and standard error: texts are split as by a shell, lists
hold a word each."""


def run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *words: Any
) -> tuple[int, str, str]:
    """Runs a command; see `Command`."""
    arguments: list[str] = []
    for word in words:
        parts = shlex.split(word) if isinstance(word, str) else word
        arguments += map(str, parts if isinstance(parts, list | tuple) else [parts])
    monkeypatch.setattr(sys, "argv", ["maidenflight", *arguments])
    show = terminal.show

    def show_and_check(*parts: Any) -> None:
        with monkeypatch.context() as without:
            without.setattr(terminal, "show", show)
            laid_out.check(parts)
        show(*parts)

    if terminal.show.__name__ == "show":
        monkeypatch.setattr(terminal, "show", show_and_check)
    try:
        cli.main()
        code = 0
    except SystemExit as leaving:
        code = int(leaving.code or 0)
    said = capsys.readouterr()
    return code, said.out, said.err
