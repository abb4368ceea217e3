"""Cells of the table of policies by default."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import polars
import pytest

from maidenflight.parameters import replace
from maidenflight.simulator.controllers import control
from maidenflight.simulator.realities.virtual_drone import virtual_drone
from scripts import script

defaults = script("defaults")


def flights(**ends: list[str]) -> polars.DataFrame:
    """Flights of policy_1 and policy_2 in places, 1 cm from the set-point."""
    rows: list[dict[str, Any]] = [
        {"place": place, "policy": policy, "end_reason": end, "position_error": 0.01}
        for place, reasons in ends.items()
        for policy, end in zip(["policy_1", "policy_2"], reasons, strict=True)
    ]
    return polars.DataFrame(rows)


def test_a_policy_is_sound_that_lasts_in_near_virtual_and_far() -> None:
    lasts, falls = ["time limit"] * 2, ["time limit", "height"]
    table = flights(near=lasts, virtual=lasts, far=falls, itself=["height", "height"])
    assert defaults.count_sound(table) == "1 of 2"
    assert defaults.count_sound(table.with_columns(position_error=0.03)) == "0 of 2"


def test_where_flights_end_the_cell_has_what_the_drone_lacks() -> None:
    table = flights(near=["time limit"] * 2, **{"+10ms": ["time limit", "tilt"]})
    policies = {
        name: SimpleNamespace(interface=control.CONTROLLERS[name]().interface)
        for name in ("pwm", "attitude_rate")
    }
    cells = {
        name: [defaults.describe(place, "crazyflie", table, one) for place in ("near", "+10ms")]
        for name, one in policies.items()
    }
    assert cells["pwm"] == ["1.0", "1.0, 1 of 2"]
    margin = defaults.rate_margin(defaults.find_reality("crazyflie+10ms").parameters).phase
    assert cells["attitude_rate"] == ["1.0", f"1.0, 1 of 2 [{np.degrees(margin):.0f} deg]"]


@pytest.mark.parametrize(("ratio", "expected"), [(1.0, " [hovers at 1.00]"), (2.0, "")])
def test_a_drone_without_thrust_left_is_named(ratio: float, expected: str) -> None:
    weak = virtual_drone(1, "near")
    weak = SimpleNamespace(parameters=replace(weak.parameters, thrust_to_weight=np.float32(ratio)))
    policy = SimpleNamespace(interface=control.pwm().interface)
    assert defaults.lacks(weak, policy) == expected
