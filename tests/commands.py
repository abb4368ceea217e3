"""Commands of the command line, run in this process."""

import shlex
import sys
from collections.abc import Callable
from typing import Any

import pytest

from maidenflight import cli

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
    try:
        cli.main()
        code = 0
    except SystemExit as leaving:
        code = int(leaving.code or 0)
    said = capsys.readouterr()
    return code, said.out, said.err
