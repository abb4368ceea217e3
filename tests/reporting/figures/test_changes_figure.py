"""Flights whose drone changes: what is drawn and told is what was flown."""

from dataclasses import replace

import numpy as np
import polars
import pytest

from drawn import of, rows, titles
from maidenflight.experiments.recovery import of_flights
from maidenflight.experiments.transfer import Transfer
from maidenflight.flights.log import Flight
from maidenflight.reporting import run as runs
from maidenflight.reporting.figures.changes import changes
from maidenflight.reporting.sections.flights import change

TIME = np.arange(0, 2.0, 0.01)
STILL = np.zeros((len(TIME), 3))
CALM = Flight(
    "made",
    0.01,
    STILL,
    STILL,
    STILL,
    STILL,
    np.full((len(TIME), 4), 0.55),
    np.full(len(TIME), 4.0),
    STILL,
    zero_order_hold=True,
)


@pytest.fixture
def flown() -> Transfer:
    """Two policies in two realities; the drone of both changes after 0.5 s, by which the first is
    8 cm away for 1 s and the second ends."""
    away = np.where((TIME > 0.495) & (TIME < 1.495), 0.08, 0.0)[:, None] * [1.0, 0.0, 0.0]
    lasts, ends = replace(CALM, position=away), replace(CALM, position=away).part(0, 80)
    given = [
        (policy, reality, end)
        for reality in ("virtual:3+yaw4000@0.5", "near:4+payload15@0.5")
        for policy, end in (("one", "time limit"), ("two", "tilt"))
    ]
    table = polars.DataFrame(given, ["policy", "reality", "end_reason"], orient="row")
    table = table.with_columns(
        flight=polars.Series([1, 2, 3, 4]),
        trial=polars.lit(1),
        duration=polars.Series([2.0, 0.8] * 2),
        **dict.fromkeys(("position_error", "command_change", "at_limits"), polars.lit(0.0)),
    )
    return Transfer(table, (lasts, ends) * 2)


def test_a_panel_a_reality_with_a_line_a_flight(flown: Transfer) -> None:
    figure = changes(of_flights(flown.table, flown.flights), flown.flights)
    assert titles(figure) == ["virtual:3+yaw4000@0.5", "near:4+payload15@0.5"]
    assert {entry.series for entry in figure.legend} == {"one", "two", None}
    [jump], [within] = of(figure, 1, kind="jump"), of(figure, 1, kind="within")
    assert (jump["x"], within["y"]) == (0.5, 5.0)
    first = of(figure, 1, kind="flight", series="one")
    assert {row["place"] for row in first} == {2}
    assert (first[0]["x"], first[-1]["x"]) == (0.0, pytest.approx(1.99))
    assert max(row["y"] for row in first) == pytest.approx(8.0)
    [end] = of(figure, 1, kind="end")
    assert (end["series"], end["x"], end["place"]) == ("two", pytest.approx(0.8), 3)
    assert {row["series"] for row in rows(figure)} == {"one", "two", None}


def test_many_long_flights_are_drawn_with_fewer_points(flown: Transfer) -> None:
    long = {name: np.tile(values, (1500, 1)) for name, values in CALM.arrays.items()}
    several = [replace(CALM, **{**long, "battery": np.tile(CALM.battery, 1500)})] * 20
    table = flown.table[[0] * 20]
    figure = changes(of_flights(table, several), several)
    assert 15_000 < len(rows(figure)) < 21_000


def test_the_section_is_of_realities_that_change(flown: Transfer) -> None:
    shown = str(change(runs.of_transfer(flown)))
    assert "near:4+payload15@0.5" in shown
    assert "recoveries" in shown
    plain = flown.table.with_columns(reality=polars.lit("near:4+payload15"))
    assert not change(runs.of_transfer(Transfer(plain, flown.flights)))
    assert not change(replace(runs.of_transfer(flown), flights=()))
