"""The script that changes constants changes them where they are used, and says what moved."""

import importlib.util
from importlib.machinery import SourceFileLoader
from typing import Any

import numpy as np
import pytest

from maidenflight.identification.design import flight_limits
from scripts import script

MARGIN = "maidenflight.identification.design.flight_limits: MARGIN"


@pytest.fixture(scope="module")
def constants() -> Any:
    return script("constants")


def test_all_numbers_of_a_constant_change(constants: Any):
    assert constants.scaled((2.0, 10, True, "s", 0), 1.4) == (2.8, 14, True, "s", 0)
    assert constants.scaled({"a": 0.9}, 1.4) == pytest.approx({"a": 0.86})
    np.testing.assert_allclose(constants.scaled(np.array([1.0, 2.0]), 0.7), [0.7, 1.4])


@pytest.mark.slow
def test_a_changed_module_uses_what_it_was_changed_to(
    constants: Any, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(SourceFileLoader, "get_code", SourceFileLoader.get_code)
    monkeypatch.setattr("__main__.scaled", constants.scaled, raising=False)
    monkeypatch.setattr("__main__.used", constants.used, raising=False)
    constants.change_imports({MARGIN: 1.4}, [MARGIN])
    specification = importlib.util.spec_from_file_location(
        flight_limits.__name__, flight_limits.__file__
    )
    assert specification is not None
    assert specification.loader is not None
    changed = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(changed)
    assert changed.MARGIN == 1.4 * flight_limits.MARGIN
    assert MARGIN not in constants.USED
    changed.FlightLimits().excess(changed.Extremes(*[0.0] * 9), (1.0, 1.0, 1.0))
    assert MARGIN in constants.USED


def test_logs_are_of_drones_whose_truth_is_known_and_each_trial_has_a_name(constants: Any):
    assert set(constants.MEASURED) <= set(script("truth_board").DRONES)
    names = [*constants.LOGS, *constants.MEASURED, *constants.OTHERS]
    assert len(set(names)) == len(names)


def test_what_moves_is_in_half_intervals_and_what_is_lost_is_infinite(constants: Any):
    before = {"estimates": {"a": (1.0, 0.0, 2.0), "b": (5.0, 4.0, 6.0)}}
    after = {"estimates": {"a": (1.05, 0.0, 2.0), "b": (5.0, 4.5, 6.0)}}
    assert constants.movement(before, after) == pytest.approx((0.0, 0.5, "b"))
    assert not constants.movement(before, after).is_harmless
    after["estimates"].pop("b")
    assert constants.movement(before, after)[:2] == (np.inf, np.inf)
