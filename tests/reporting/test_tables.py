"""Tables and templates escape all that is not markup, and cells are sorted by their values."""

import math
import re
from urllib.parse import unquote

import polars
import pytest
from jinja2 import UndefinedError
from markupsafe import Markup

from maidenflight.reporting import tables, text
from maidenflight.reporting.html import render
from maidenflight.reporting.tables import Cell, Column

EVIL = '"><script>alert(1)</script>&'


def test_text_of_a_table_is_escaped_and_markup_is_kept():
    rows = polars.DataFrame({"name": [EVIL, "two"], "more": [EVIL, "x"]})
    bold = Column("More", lambda value, row: Cell(Markup("<b>{}</b>").format(row["name"]), value))
    made = tables.sortable("evil", rows, {"name": EVIL, "more": bold}, viewed={0})
    assert "<script" not in made
    assert "<b>two</b>" in made
    assert made.count("alert(1)") == 6  # head, button twice, two cells' values, a cell
    assert made.count("<button type=button class=choose") == 1, "the second is not in the viewer"
    [saved] = re.findall(r'href="data:text/csv;charset=utf-8,([^"]*)"', made)
    assert polars.read_csv(unquote(saved).encode()).equals(rows)


def test_a_template_with_a_name_missing_is_an_error():
    with pytest.raises(UndefinedError):
        render("flights.html")


@pytest.mark.parametrize(
    ("value", "shown", "key"),
    [
        (-1.234, "\N{MINUS SIGN}123.4", "-1.234"),
        (math.nan, text.NOTHING, ""),
        (math.inf, text.NOTHING, ""),
        (None, text.NOTHING, ""),
    ],
)
def test_a_number_is_shown_in_its_unit_and_sorted_by_its_value(value, shown, key):
    cell = tables.number("share [%]", 1, 100.0).show(value, {})
    assert (cell.content, cell.key) == (shown, key)
    assert tables.plain(3) == Cell("3", 3)
