"""Flights, identifications and policies draw themselves, for notebooks."""

import re

import numpy as np
import pytest
from test_identification_figure import found

import maidenflight as mf
from drawn import of, titles
from flying_policy import flying_policy
from made_flights import driven
from maidenflight.errors import InputError
from maidenflight.identification.posterior import Posterior
from maidenflight.reporting.figures import plots


def test_a_flight_draws_its_signals_and_is_short_in_a_notebook(tmp_path):
    flight = driven()
    picture = flight.plot()
    assert titles(picture.figure)[0] == "position x, y, z [m]"
    first = of(picture.figure, series="1")[0]
    assert first["y"] == pytest.approx(float(flight.position[0, 0]), abs=1e-3)
    picture.save(tmp_path / "flight.svg")
    assert (tmp_path / "flight.svg").read_text().startswith("<svg")
    assert [one.name for one in picture.figure.legend][:1] == ["x, roll, motor 1"]
    assert len(repr(flight)) < 120


def test_a_picture_is_written_as_what_its_suffix_says(tmp_path):
    picture = driven().plot()
    for suffix, head in {"pdf": b"%PDF", "png": b"\x89PNG", "SVG": b"<svg"}.items():
        picture.save(tmp_path / f"figure.{suffix}")
        assert (tmp_path / f"figure.{suffix}").read_bytes().startswith(head), suffix
    with pytest.raises(InputError, match=r"figure\.eps: .*\.pdf"):
        picture.save(tmp_path / "figure.eps")
    assert not (tmp_path / "figure.eps").exists()


@pytest.mark.parametrize(("width", "expected"), [(None, 88.0), (60.0, 60.0), (180.0, 180.0)])
def test_a_pdf_is_as_wide_on_paper_as_it_is_asked_to_be_in_one_font(tmp_path, width, expected):
    found().plot().save(tmp_path / "estimates.pdf", width)
    content = (tmp_path / "estimates.pdf").read_bytes()
    [(_, _, across, _)] = [
        map(float, box.split()) for box in re.findall(rb"/MediaBox ?\[([^]]*)\]", content)
    ]
    assert across * 25.4 / 72 == pytest.approx(expected, abs=0.1)
    fonts = {font.partition(b"+")[2] for font in re.findall(rb"/BaseFont ?/(\S+)", content)}
    assert fonts == {b"LiberationSans", b"LiberationSans-Bold"}
    with pytest.raises(InputError):
        found().plot().save(tmp_path / "none.pdf", 0.0)


def test_a_corner_of_many_parameters_is_a_page_wide_and_small(tmp_path):
    draws = np.random.default_rng(0).normal(1e-5, 1e-6, (8, 400))
    names = [f"{one}_{axis}" for one in ("inertia", "torque_bias", "drag") for axis in "xyz"]
    picture = plots.plot_posterior(Posterior(dict(zip(names, draws, strict=False))))
    picture.save(tmp_path / "corner.pdf")
    content = (tmp_path / "corner.pdf").read_bytes()
    assert len(content) < 1.2e6
    assert b"DejaVu" not in content


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
