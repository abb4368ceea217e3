"""Box plots, the literature and trims: what is drawn is what was flown and found, and what cannot
be drawn is refused."""

import numpy as np
import polars
import pytest
from drawn import of, rows, titles

from maidenflight.errors import InputError
from maidenflight.identification.drone_file import Estimate
from maidenflight.parameters import COMPONENTS, QUANTITIES
from maidenflight.reporting import literature
from maidenflight.reporting.flight_figures import BOXED, MOST, flight_times
from maidenflight.reporting.literature_figure import beside_literature
from maidenflight.reporting.trim_figure import trims


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


def test_the_median_and_the_box_lie_at_their_quantiles():
    figure = flight_times(flights(9))
    [box], [median] = of(figure, kind="box"), of(figure, kind="median")
    assert (box["x"], median["x"], box["x2"]) == (3.0, 5.0, 7.0)
    assert [(one["x"], one["x2"]) for one in of(figure, kind="whisker")] == [(1.0, 3.0), (7.0, 9.0)]
    drawn = of(figure, kind="flight")
    assert [one["x"] for one in drawn] == [float(n) for n in range(1, 10)]
    assert len({one["shape"] for one in drawn[:-1]}) == 1
    assert drawn[-1]["shape"] != drawn[0]["shape"], "the last one reached the limit"
    assert {entry.name for entry in figure.legend} == {
        "flight to the time limit",
        "flight ended by a guard",
    }


def test_few_flights_are_dots_without_a_box():
    figure = flight_times(flights(BOXED - 1))
    assert {row["kind"] for row in rows(figure)} == {"flight"}
    many = flight_times(flights(200))
    assert of(many, kind="flight") == [], "beyond the whiskers of equal steps is none"


def test_a_panel_a_reality_and_rows_of_a_group_together():
    figure = flight_times(flights(panels=("near-7", "far-7"), rows=("one", "two")))
    assert titles(figure) == ["near-7", "far-7"]
    mixed = flights(rows=("b\tsame", "a", "c\tsame")).with_columns(
        group=polars.col("row").str.slice(0, 1).replace({"c": "b"}),
        colour=polars.lit("orange"),
    )
    [panel] = flight_times(mixed, labels={"orange": "Attitude rate"}).panels
    y = panel["layer"][0]["encoding"]["y"]
    assert y["scale"]["domain"] == ["b\tsame", "c\tsame", "a"]
    assert {row["name"] for row in rows(flight_times(mixed))} == {"same", "a"}


def test_of_many_rows_the_first_are_drawn():
    figure = flight_times(flights(2, rows=[f"policy {n}" for n in range(MOST + 5)]))
    assert len({row["row"] for row in rows(figure)}) == MOST


def test_nothing_to_draw_is_refused():
    with pytest.raises(InputError, match="no column end_reason"):
        flight_times(flights().drop("end_reason"))
    with pytest.raises(InputError, match="no flights"):
        flight_times(flights().with_columns(duration=polars.lit(float("nan"))))
    with pytest.raises(InputError, match="no parameter"):
        beside_literature({"drag_x": Estimate(0.3, (0.2, 0.4), (0.3,), 0.0)})


def test_what_others_give_is_within_the_bounds_of_the_parameter():
    for name, (field, _) in COMPONENTS.items():
        for each in literature.published(name):
            assert QUANTITIES[field].lower <= each.value <= QUANTITIES[field].upper
            assert each.source


def test_values_are_multiples_of_the_papers_and_told_as_they_are():
    found = {"motor_time_constant": Estimate(0.176, (0.132, 0.22), (0.176,), 0.0)}
    figure = beside_literature(found, {"motor_time_constant": (0.088, 0.132)})
    identified = of(figure, series="identified")
    assert [one["x"] for one in identified] == pytest.approx([2.0, 1.5])
    assert identified[1]["x2"] == pytest.approx(2.5)
    assert (identified[0]["told"], identified[0]["between"]) == ("176 ms", "132 .. 220 ms")
    assert [one["x"] for one in of(figure, series="paper")] == [1.0]
    assert [one["x"] for one in of(figure, series="truth")] == pytest.approx([1.0, 1.5])
    others = {one["source"]: one["x"] for one in of(figure, series="others")}
    for each in literature.published("motor_time_constant"):
        assert others[each.source] == pytest.approx(each.value / 0.088, rel=1e-5)
    low, high = figure.panels[0]["layer"][0]["encoding"]["x"]["scale"]["domain"]
    assert all(low < row["x"] < high for row in rows(figure))


def test_trims_are_drawn_over_the_flights_with_what_was_identified_across():
    table = polars.DataFrame(
        {
            "number": [1, 2],
            "flight": ["monday", "tuesday"],
            "thrust_to_weight": [1.7, 1.8],
            "thrust_to_weight_error": [0.1, float("nan")],
            **{f"torque_bias_{axis}": [1e-6, -2e-6] for axis in "xyz"},
            "battery": [float("nan")] * 2,
        }
    )
    figure = trims(table, {"thrust_to_weight": Estimate(1.75, (1.7, 1.8), (1.75,), 0.0)})
    assert len(figure.panels) == 4, "the battery is not known"
    one, two, identified = rows(figure)
    assert (one["y"], one["low"], one["high"]) == pytest.approx((1.7, 1.6, 1.8))
    assert (two["name"], two["place"], two["error"]) == ("tuesday", 1, None)
    assert (identified["series"], identified["low"]) == ("identified", 1.7)
    np.testing.assert_allclose([row["y"] for row in rows(figure, 1)], [1.0, -2.0])
