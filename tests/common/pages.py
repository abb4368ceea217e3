"""Code in the README and the docs, and what runs it."""

import re
import textwrap
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def section(page: str, title: str) -> str:
    """A section of a page, without those below it, or the content of one of its tabs."""
    head, end = rf'^(?:##+ {re.escape(title)}|=== "{re.escape(title)}")$', r"^##+ |^=== |\Z"
    (own,) = re.findall(rf"{head}(.*?)(?={end})", (ROOT / page).read_text(), re.M | re.S)
    return textwrap.dedent(own)


def blocks(page: str, language: str, title: str | None = None) -> list[str]:
    """The code of a language in a page, its tabs included, or in a section or tab of it."""
    text = (ROOT / page).read_text() if title is None else section(page, title)
    code = re.findall(rf"^( *)```{language}\n(.*?)^\1```", text, re.M | re.S)
    return [textwrap.dedent(block) for _, block in code]


def run_python(page: str, title: str | None = None, **names: Any) -> dict[str, Any]:
    """Runs the only Python of a page, or of a section or tab; returns the names it has then."""
    (snippet,) = blocks(page, "python", title)
    return run_snippet(snippet, page, names)


def run_snippet(snippet: str, page: str, names: dict[str, Any] | None = None) -> dict[str, Any]:
    """Runs Python of a page, perhaps after what it builds on; returns the names it has then."""
    names = {} if names is None else names
    exec(compile(snippet, page, "exec"), names)
    return names
