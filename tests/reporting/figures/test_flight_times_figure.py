"""Box plots of flight times: what is drawn is what was flown, and what cannot be is refused."""

import polars
import pytest

from drawn import of, rows, titles
from maidenflight.errors import InputError
from maidenflight.reporting.figures.flight_times import BOXED, MAX_FLIGHTS, flight_times


def flights(count=9, panels=("near:7",), rows=("one",)):
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
    figure = flight_times(flights(panels=("near:7", "far:7"), rows=("one", "two")))
    assert titles(figure) == ["near:7", "far:7"]
    mixed = flights(rows=("b\tsame", "a", "c\tsame")).with_columns(
        group=polars.col("row").str.slice(0, 1).replace({"c": "b"}),
        colour=polars.lit("orange"),
    )
    [panel] = flight_times(mixed, labels={"orange": "Attitude rate"}).panels
    y = panel["layer"][0]["encoding"]["y"]
    assert y["scale"]["domain"] == ["b\tsame", "c\tsame", "a"]
    assert {row["name"] for row in rows(flight_times(mixed))} == {"same", "a"}


def test_of_many_rows_the_first_are_drawn():
    figure = flight_times(flights(2, rows=[f"policy {n}" for n in range(MAX_FLIGHTS + 5)]))
    assert len({row["row"] for row in rows(figure)}) == MAX_FLIGHTS


def test_nothing_to_draw_is_refused():
    with pytest.raises(InputError, match="no column end_reason"):
        flight_times(flights().drop("end_reason"))
    with pytest.raises(InputError, match="no flights"):
        flight_times(flights().with_columns(duration=polars.lit(float("nan"))))
