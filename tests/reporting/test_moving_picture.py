"""The moving picture: it moves by itself, loads nothing, and is there in light and in dark."""

import importlib.util
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def example() -> ModuleType:
    found = importlib.util.spec_from_file_location(
        "moving_picture", ROOT / "examples" / "moving_picture.py"
    )
    assert found is not None
    assert found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def test_a_drone_is_drawn_where_it_is_in_every_picture(example):
    position = np.zeros((3, 5, 3))
    position[:, :, 2] = np.linspace(1.0, 0.0, 5)
    alive = np.ones((3, 5))
    alive[:, 4] = 0
    drawn = example.picture(
        [example.Film("10 steps", "all down", position, np.zeros((3, 5, 3)), alive)]
    )
    changes = {
        part.attrib["attributeName"]: part.attrib
        for part in ElementTree.fromstring(drawn).iter("{http://www.w3.org/2000/svg}animate")
    }
    assert set(changes) == {"opacity", "cx", "cy", "stroke-dasharray", "d"}
    # Frames of the flight, and the last of them again while it rests.
    assert {len(change["values"].split(";")) for change in changes.values()} == {
        5 + round(example.REST * example.FRAMES)
    }
    arms = changes["d"]["values"].split(";")[0]
    corners = np.array(
        [[float(number) for number in pair.split()] for pair in re.findall(r"[ML]([^MLa]+)", arms)]
    )
    np.testing.assert_allclose(corners[:4].mean(axis=0), example.seen(position[0, 0]), atol=30)
    assert re.findall(r"https?://[^\"']+", drawn) == ["http://www.w3.org/2000/svg"]


def test_the_picture_of_the_readme_is_small_and_alone():
    kept = (ROOT / "docs" / "learning.svg").read_text(encoding="utf-8")
    assert len(kept) < 1_500_000
    assert kept.count("<animate ") > 20
    assert "prefers-color-scheme: dark" in kept
    assert "<script" not in kept
