"""The page that benchmarks write their tables into."""

from pathlib import Path

import click


def write(page: Path, parts: dict[str, str]) -> None:
    """Puts each part between its markers of the page."""
    text = page.read_text()
    for name, part in parts.items():
        before, marker, rest = text.partition(f"<!-- {name} -->\n")
        if not marker:
            raise click.ClickException(f"{page} has no line <!-- {name} -->.")
        text = before + marker + part + rest[rest.index("\n<!-- end -->") :]
    page.write_text(text)
