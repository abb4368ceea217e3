"""Flights, identifications and policies draw themselves, for notebooks."""

import numpy as np
import pytest

import maidenflight as mf
from flying_policy import flying_policy
from made_flights import driven
from maidenflight.errors import InputError
from maidenflight.reporting.figures import plots
from reporting.drawn import of, titles
from reporting.figures.test_identification_figure import found


def test_a_flight_draws_its_signals_and_is_short_in_a_notebook(tmp_path):
    flight = driven()
    picture = flight.plot()
    assert titles(picture.figure)[0] == "position x, y, z [m]"
    first = of(picture.figure, series="1")[0]
    assert first["y"] == pytest.approx(float(flight.position[0, 0]), abs=1e-3)
    picture.save(tmp_path / "flight.svg")
    assert (tmp_path / "flight.svg").read_text() == picture._repr_svg_()
    assert len(repr(flight)) < 120


def test_a_picture_is_written_as_what_its_suffix_says(tmp_path):
    picture = driven().plot()
    for suffix, head in {"pdf": b"%PDF", "png": b"\x89PNG", "SVG": b"<svg"}.items():
        picture.save(tmp_path / f"figure.{suffix}")
        assert (tmp_path / f"figure.{suffix}").read_bytes().startswith(head), suffix
    with pytest.raises(InputError, match=r"figure\.eps: .*\.pdf"):
        picture.save(tmp_path / "figure.eps")
    assert not (tmp_path / "figure.eps").exists()


def test_an_identification_draws_its_estimates():
    rows = of(found().plot().figure, kind="value")
    assert [row["name"] for row in rows] == ["thrust-to-weight ratio", "latency"]


def test_a_policy_draws_its_commands_over_the_distance_to_the_set_point():
    policy = flying_policy(mf.crazyflie())
    figure = plots.plot_policy(policy).figure
    assert titles(figure) == [f"set-point along {axis}" for axis in "xyz"]
    commands = [row["y"] for row in of(figure, 2, series="1")]
    assert len(commands) == 21
    assert np.mean(commands[-3:]) > np.mean(commands[:3]), "it climbs to a set-point above"


def test_named_drones_are_had_by_name():
    assert float(mf.drone("crazyflie_brushless").mass) == pytest.approx(0.037)
    with pytest.raises(InputError, match="Expected one of crazyflie"):
        mf.drone("crazyfly")
