"""What a command prints fits terminals of several widths, with words and paths whole."""

import io
import os
import re
from contextlib import redirect_stdout
from unittest import mock

from maidenflight import terminal
from maidenflight.terminal import Table

WIDTHS = 60, 80, 120, 200
_OWN = "This terminal is too narrow for:"


def words_of(text: str) -> set[str]:
    return set(re.sub(r"─+", " ", text).split())


def source_of(parts: tuple[Table | str, ...]) -> str:
    texts = [_OWN]
    for part in parts:
        if isinstance(part, str):
            texts.append(part)
        else:
            texts += [part.title, *part.columns, *(cell for row in part.cells for cell in row)]
            texts += [f"{name}, {name}." for name in part.columns]
    return "\n".join(texts)


def check(parts: tuple[Table | str, ...]) -> None:
    """Prints parts at each width; all in memory."""
    known = words_of(terminal.printable(source_of(parts)))
    for width in WIDTHS:
        text = io.StringIO()
        with mock.patch.dict(os.environ, {"COLUMNS": str(width)}), redirect_stdout(text):
            terminal.show(*parts)
        shown = text.getvalue()
        assert words_of(shown) <= known, (width, words_of(shown) - known)
        # Paths stay whole, and long ones may push the rest out.
        if max(map(len, known)) < width / 4:
            assert all(len(line.rstrip()) <= width for line in shown.splitlines()), (width, shown)
