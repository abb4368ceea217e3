"""The page's glossary says what that of the documentation does."""

import re
from html import unescape
from pathlib import Path

from maidenflight.reporting.html import render

PAGE = Path(__file__).parents[2] / "docs" / "glossary.md"


def test_the_glossary_of_the_page_is_that_of_the_documentation() -> None:
    rows = re.findall(r"<tr>(.*?)</tr>", render("glossary.html"))
    shown = [
        [
            re.sub(r"</?code>", "`", unescape(one))
            for one in re.findall(r"<t[hd][^>]*>(.*?)</t", row)
        ]
        for row in rows
    ]
    written = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in PAGE.read_text().splitlines()
        if line.startswith("|") and not set(line) <= set("|- ")
    ]
    assert len(written) > 20
    assert shown == written
