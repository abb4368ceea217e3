"""The picture beside a drone file: what is marked lies where the numbers say."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import polars
import pytest

from maidenflight.identification.drone_file import Estimate, GroupGain, Source
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.signals.motor_response import Look
from maidenflight.parameters import crazyflie
from maidenflight.reporting.identification_picture import identification_picture

SVG = "{http://www.w3.org/2000/svg}"


def found(**changes):
    values = {
        "parameters": crazyflie(),
        "estimates": {
            "thrust_to_weight": Estimate(1.7, (1.6, 1.9), (1.7,), 0.0),
            "latency": Estimate(0.01, (0.008, 0.012), (0.01,), 0.0),
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
        "lag_looks": (Look("gyro x", 0.1, (0.09, 0.12)), Look("taken", 0.08, (0.07, 0.09))),
    }
    return Identification(**values | changes)


def drawn(picture):
    """Panels by name, and all words."""
    tree = ElementTree.fromstring(picture)
    panels = {
        part.attrib["data-panel"]: part
        for part in tree.iter(f"{SVG}svg")
        if "data-panel" in part.attrib
    }
    return panels, ["".join(part.itertext()) for part in tree.iter(f"{SVG}text")]


def bars(panel, colour):
    """Left and right end and centre of each interval of a colour [px]."""
    paths = [
        part.attrib["d"]
        for part in panel.iter(f"{SVG}path")
        if part.attrib["class"] == "heavy" and f"--{colour})" in part.attrib["style"]
    ]
    level = [re.fullmatch(r"M([\d.]+) [\d.]+H([\d.]+)", path) for path in paths]
    upright = [re.fullmatch(r"M([\d.]+) [\d.]+v12", path) for path in paths]
    ends = [[float(one[1]), float(one[2])] for one in level if one]
    return np.array(
        [[*end, float(one[1])] for end, one in zip(ends, filter(None, upright), strict=True)]
    )


def test_intervals_looks_and_gains_lie_where_their_numbers_say():
    panels, words = drawn(identification_picture(found(), crazyflie()))
    assert list(panels) == ["intervals", "looks", "gains"]
    for low, high, centre in bars(panels["intervals"], "orange")[:1]:
        assert (centre - low) / (high - low) == pytest.approx((1.7 - 1.6) / (1.9 - 1.6), abs=0.01)
    [gyro], [taken] = (bars(panels["looks"], colour) for colour in ("blue", "orange"))
    per_ms = (gyro[1] - gyro[0]) / 30
    assert (gyro[2] - taken[2]) / per_ms == pytest.approx(20, abs=0.2)
    [kept], [not_kept] = (bars(panels["gains"], colour) for colour in ("orange", "soft"))
    assert not_kept[0] == not_kept[1], "no standard error"
    assert kept[0] > not_kept[2]
    for said in ("1.70 [1.60, 1.90], start 1.73", "100.0 [90.0, 120.0] ms", "drag z"):
        assert said in words
    assert any("+0.1 ± 0.01, kept" in word for word in words)


def test_what_is_not_known_is_left_out():
    alone = found(gains=(), lag_looks=(), unidentified={})
    panels, words = drawn(identification_picture(alone, crazyflie()))
    assert list(panels) == ["intervals"]
    assert not any("plausible" in word for word in words)
