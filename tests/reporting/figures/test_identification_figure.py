"""The picture beside a drone file: what is marked lies where the numbers say."""

import polars
import pytest

from drawn import of, titles
from maidenflight.identification.drone_file import Estimate, GroupGain, Source
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.uncertainty import Evidence
from maidenflight.parameters import crazyflie
from maidenflight.reporting.figures.identification import estimates, identification
from maidenflight.reporting.figures.picture import svg


def found(**changes):
    values = {
        "parameters": crazyflie(),
        "estimates": {
            "thrust_to_weight": Estimate(1.7, (1.6, 1.9), (1.7,), 0.0, plausible=(1.4, 2.2)),
            "latency": Estimate(0.01, (0.008, 0.012), (0.01,), 0.0, plausible=(0.0, 0.03)),
        },
        "unidentified": {"drag_z": (0.0, 0.5)},
        "expected": {},
        "objective": "likelihood",
        "value": -15.0,
        "start_value": -14.0,
        "windows": 10,
        "source": Source(2, 60.0, False, "subsampled", 60000.0),
        "evaluations": 5,
        "seconds": 1.0,
        "search": polars.DataFrame(),
        "posterior": {},
        "gains": (GroupGain("drag", 0.1, 0.01, True), GroupGain("inertia", -1e-5, None, False)),
        "noise": {},
        "notes": (),
        "evidence": (
            Evidence("gyro x", 0.1, (0.09, 0.12)),
            Evidence("taken", 0.08, (0.07, 0.09), is_taken=True),
        ),
    }
    return Identification(**values | changes)


def numbers(figure, panel=0):
    """Names and numbers beside the rows of a panel."""
    keys = figure.panels[panel]["layer"][0]["encoding"]["y"]["scale"]["domain"]
    return [tuple(key.split("\t")[1:]) for key in keys]


def test_intervals_looks_and_gains_lie_where_their_numbers_say():
    figure = identification(found(), crazyflie())
    assert titles(figure) == [
        "",
        "Motor lag, of both ways together, plus latency",
        "Log-likelihood gain of each group",
    ]
    [bar], [value] = of(figure, kind="bar", row=0), of(figure, kind="value", row=0)
    share = (value["x"] - bar["x"]) / (bar["x2"] - bar["x"])
    assert share == pytest.approx((1.7 - 1.6) / (1.9 - 1.6), abs=1e-5)
    [unknown] = of(figure, series="unidentified")
    assert (unknown["name"], unknown["kind"]) == ("drag z", "bar")
    gyro, taken = of(figure, 1, kind="value")
    assert (gyro["x"], taken["x"]) == (100.0, 80.0)
    kept, not_kept = of(figure, 2, kind="bar")
    assert (kept["x"], kept["x2"]) == pytest.approx((0.08, 0.12))
    assert not_kept["x"] == not_kept["x2"] == -1e-5, "no standard error"
    assert numbers(figure)[0] == ("thrust-to-weight ratio", "1.70 [1.60, 1.90]", ", start 1.73")
    assert numbers(figure, 1)[0] == ("gyro x", "100.0 [90.0, 120.0] ms")
    assert numbers(figure, 2)[0] == ("drag", "+0.1 \N{PLUS-MINUS SIGN} 0.01", ", in the model")


def test_what_is_not_known_is_left_out():
    figure = identification(found(gains=(), evidence=(), unidentified={}), crazyflie())
    assert len(figure.panels) == 1
    assert [entry.series for entry in figure.legend] == ["identified", "start"]


def test_nothing_that_was_identified_makes_an_empty_picture():
    nothing = found(gains=(), evidence=(), unidentified={}, estimates={})
    assert svg(identification(nothing, crazyflie())).startswith("<svg")


def test_what_is_known_besides_is_marked_on_the_same_scale():
    known = {"latency": Estimate(0.01, (0.008, 0.012), (0.01,), 0.0, plausible=(0.0, 0.03))}
    figure = estimates(
        known,
        {"drag_z": (0.0, 0.5)},
        {"truth": {"latency": [0.01, 0.014]}, "paper": {"latency": [0.018]}},
    )
    [value] = of(figure, kind="value")
    first, last = of(figure, series="truth")
    assert (first["x"], first["value"]) == (value["x"], "10.0")
    [paper] = of(figure, series="paper")
    assert 0 < value["x"] < last["x"] < paper["x"] < 1
    # Latencies are plausible up to 30 ms.
    assert (value["x"], last["x"]) == pytest.approx((1 / 3, 14 / 30))
    assert numbers(figure) == [
        ("latency", "10.0 [8.0, 12.0] ms", ", truth 10.0 .. 14.0"),
        ("drag z", "not identified, 0.00 .. 0.50 1/s", ""),
    ]
    [unknown] = of(figure, series="unidentified")
    assert (unknown["x"], unknown["x2"]) == (0.0, 1.0)


def test_on_a_phone_numbers_stand_below_names_and_the_plot_keeps_its_place():
    [panel] = estimates(found().estimates, {}, {}).panels
    left, right = (layer["encoding"]["y"]["axis"] for layer in panel["layer"][:2])
    assert right["wide"]["orient"] == "right"
    assert right["narrow"] is None
    assert left["labelExpr"]["narrow"] != left["labelExpr"]["wide"]
    assert panel["height"]["narrow"] > panel["height"]["wide"]
    drawn = svg(estimates(found().estimates, {}, {}), 390)
    assert "100%" in drawn
    assert "100.0" not in drawn, "whole percents"


def test_what_lies_or_runs_outside_the_frame_is_an_arrow_at_its_edge() -> None:
    bounds = (0.0, 1.0)
    figure = estimates(
        {
            "drag_x": Estimate(0.5, (-1.0, 3.0), (0.5,), 0.0, plausible=bounds),
            "drag_y": Estimate(2.0, (0.9, 2.5), (2.0,), 0.0, plausible=bounds),
            "drag_z": Estimate(0.5, (0.4, 0.6), (0.5,), 0.0, plausible=bounds),
        },
        {},
        {"start": {"drag_z": [-7.0]}},
    )
    low, high = figure.panels[0]["layer"][0]["encoding"]["x"]["scale"]["domain"]
    left, right = of(figure, kind="left"), of(figure, kind="right")
    assert [(row["row"], row["series"]) for row in left] == [(0, "weak"), (2, "start")]
    assert {row["row"] for row in right} == {0, 1}
    assert all(low < row["x"] < low + 0.05 for row in left)
    assert all(high - 0.05 < row["x"] < high for row in right)
    assert "lies or runs farther out" in [entry.name for entry in figure.legend]
    assert "farther" not in svg(identification(found(), crazyflie()))
