"""Tables and templates escape all that is not markup, and cells are sorted by their values."""

import math
import re
from urllib.parse import unquote

import polars
import pytest
from jinja2 import UndefinedError
from markupsafe import Markup

from maidenflight.reporting import svg, tables, text
from maidenflight.reporting.html import render
from maidenflight.reporting.tables import Cell

EVIL = '"><script>alert(1)</script>&'


def test_text_of_a_table_is_escaped_and_markup_is_kept():
    rows = [[tables.choice(EVIL, EVIL), tables.plain(EVIL)], [Cell(Markup("<b>1</b>"), 1.0)]]
    made = tables.sortable(
        "evil", [("name", EVIL), ("more", "More")], rows, polars.DataFrame({"name": [EVIL]})
    )
    assert "<script" not in made
    assert "<b>1</b>" in made
    assert made.count("alert(1)") == 6  # head, button twice, two cells' values, a cell
    [saved] = re.findall(r'href="data:text/csv;charset=utf-8,([^"]*)"', made)
    assert polars.read_csv(unquote(saved).encode()).to_dict(as_series=False) == {"name": [EVIL]}


def test_text_of_a_picture_is_escaped_and_markup_is_kept():
    drawn = svg.picture(100, 50, EVIL, [svg.text(0, 0, EVIL), svg.text(0, 9, svg.symbol("mass"))])
    panel = svg.Panel(0, 0, 9, 9, (0, 1), (0, 1))
    legend, _ = svg.legend(0, 100, [("", EVIL)])
    note, _ = svg.paragraph(0, 0, 100, EVIL)
    for part in (drawn, svg.framed(panel, [], EVIL), legend, note):
        assert "<script" not in part
    assert str(svg.symbol("mass")) in drawn


def test_a_template_with_a_name_missing_is_an_error():
    with pytest.raises(UndefinedError):
        render("flights.html")


@pytest.mark.parametrize(
    ("cell", "key"),
    [
        (tables.number(1.234, 1), "1.234"),
        (tables.number(math.nan, 1), ""),
        (tables.number(math.inf, 1), ""),
        (tables.plain(3), "3"),
        (tables.choice(3, "flight 3"), "3"),
    ],
)
def test_a_cell_is_sorted_by_its_value(cell, key):
    assert cell.key == key


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (0.098, 0.0054, ("+0.0980", "0.0054")),
        (-3.1e-6, 4.3e-7, ("-0.00000310", "0.00000043")),
        (0.0, 0.0, ("+0.0000", "0.0000")),
        (0.0018, None, ("+0.0018", "unknown")),
    ],
)
def test_a_gain_has_two_digits_of_its_standard_error(value, error, shown):
    assert text.with_error(value, error) == shown
