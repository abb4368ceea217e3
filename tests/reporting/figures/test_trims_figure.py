"""Trims flight by flight: what is drawn is what was found."""

import numpy as np
import polars
import pytest

from drawn import rows
from made_flights import driven
from maidenflight.flights import flight_csv
from maidenflight.identification.drone_file import Estimate
from maidenflight.reporting.figures.trims import trims
from maidenflight.reporting.run import read_run
from maidenflight.reporting.sections.flights import _trims_of


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


def test_without_a_drone_there_are_no_torques(tmp_path):
    flight_csv.write(tmp_path / "logs" / "a.csv", driven())
    flight_csv.write(tmp_path / "logs" / "b.csv", driven())
    rows_of = _trims_of(read_run(None, {"logs": [tmp_path / "logs"]}))
    assert rows_of.height == 2
    assert not [name for name in rows_of.columns if "torque" in name or "thrust" in name]
    assert (rows_of["hover_command"] > 0).all()
    assert (rows_of["hover_command_error"] > 0).all()
