"""Box plots and the literature: what is drawn lies where the axis says, and what cannot be drawn is
refused."""

import re
import xml.etree.ElementTree as ElementTree

import polars
import pytest

from maidenflight.errors import InputError
from maidenflight.identification.drone_file import Estimate
from maidenflight.parameters import COMPONENTS, QUANTITIES
from maidenflight.reporting import literature
from maidenflight.reporting.flight_figures import flight_times
from maidenflight.reporting.literature_figure import beside_literature

SVG = "{http://www.w3.org/2000/svg}"


def flights(count=9, panels=("near-7",), rows=("one",)):
    """Flights of 1, 2, 3, ... seconds; the last one reaches the limit."""
    each = [
        {"duration": float(n), "end_reason": "tilt" if n < count else "time limit"}
        for n in range(1, count + 1)
    ]
    return polars.DataFrame(
        [
            {"row": row, "colour": "blue", "panel": panel, **flight}
            for panel in panels
            for row in rows
            for flight in each
        ]
    )


def paths(picture, panel, look):
    [found] = [
        part
        for part in ElementTree.fromstring(picture).iter(f"{SVG}svg")
        if part.attrib.get("data-panel") == panel
    ]
    return float(found.attrib["width"]), [
        part.attrib["d"] for part in found.iter(f"{SVG}path") if part.attrib["class"] == look
    ]


def test_the_median_and_the_box_lie_at_their_quantiles():
    width, [median] = paths(flight_times(flights(9)), "flights", "heavy")
    _, [box] = paths(flight_times(flights(9)), "flights", "filled faint")
    across = width / (1.04 * 9)
    assert float(re.findall(r"M([\d.]+)", median)[0]) == pytest.approx(5 * across, abs=0.1)
    left, right = float(re.findall(r"M([\d.]+)", box)[0]), float(re.findall(r"H([\d.]+)", box)[0])
    assert (left, right) == (pytest.approx(3 * across, abs=0.1), pytest.approx(7 * across, abs=0.1))


def test_few_flights_are_dots_without_a_box():
    assert paths(flight_times(flights(4)), "flights", "filled faint")[1] == []
    assert paths(flight_times(flights(4)), "flights", "dots faded")[1][0].count("h0") == 1, (
        "the one that reached the limit"
    )
    assert (
        paths(flight_times(flights(4)), "flights", "thin faded")[1][0].count("M") == 2 * 3 - 3 * 1
    ), "a cross for each of the others"


def test_panels_stand_beside_each_other_or_below_on_a_phone():
    for width, places in ((1072, 3), (343, 1)):
        picture = ElementTree.fromstring(flight_times(flights(panels=("a", "b", "c")), width))
        found = [part for part in picture.iter(f"{SVG}svg") if "data-panel" in part.attrib]
        assert len({part.attrib["x"] for part in found}) == places


def test_long_names_are_cut_and_told_in_full():
    name = "a_policy_with_quite_a_long_name_<of_its_own>" * 2
    picture = flight_times(flights(rows=(name,)), 343)
    assert [part.text for part in ElementTree.fromstring(picture).iter(f"{SVG}title")] == [name]


def test_nothing_to_draw_is_refused():
    with pytest.raises(InputError, match="no flights"):
        flight_times(flights(0).clear() if flights(0).columns else flights(1).clear())
    with pytest.raises(InputError, match="no column panel"):
        flight_times(flights(1).drop("panel"))
    with pytest.raises(InputError, match="no parameter to draw"):
        beside_literature({"drag_x": Estimate(0.3, (0.2, 0.4), (0.3,), 0.0)})


def test_what_others_give_is_within_the_bounds_of_the_parameter():
    for name, (field, _) in COMPONENTS.items():
        for each in literature.published(name):
            assert QUANTITIES[field].lower <= each.value <= QUANTITIES[field].upper
            assert each.source


def test_twice_the_papers_value_is_drawn_at_two():
    picture = beside_literature(
        {"motor_time_constant": Estimate(0.176, (0.176, 0.176), (0.176,), 0.0)}
    )
    width, [mark] = paths(picture, "literature", "heavy")
    one = float(re.findall(r"M([\d.]+) 0V", paths(picture, "literature", "line")[1][0])[0])
    grid = [
        float(place)
        for place in re.findall(r"M([\d.]+) 0V", paths(picture, "literature", "grid")[1][0])
    ]
    assert any(
        float(re.findall(r"M([\d.]+)", mark)[1]) == pytest.approx(place, abs=0.1)
        for place in grid
        if place > one
    )
    assert one < width
