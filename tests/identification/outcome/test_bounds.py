"""Estimates at a bound of their search are found and refused, and what notes advise is possible."""

import re
from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from made_flights import calm
from maidenflight import cli, policy, policy_file
from maidenflight.errors import InputError
from maidenflight.identification.drone_file import DroneFile, Estimate, Search, Source
from maidenflight.identification.outcome.bounds import (
    at_bounds,
    bound_reached,
    cut_off,
    equivalent_lag_estimates,
    must_lie_within_bounds,
    widened,
)
from maidenflight.identification.outcome.problem import Problem
from maidenflight.identification.posterior import Posterior
from maidenflight.identification.signals.motor_response import LAG_BOUNDS
from maidenflight.identification.unknowns import (
    PAPER_BOUNDS,
    is_logarithmic,
    physical_bounds,
    search_box,
)
from maidenflight.parameters import COMPONENTS, QUANTITIES, crazyflie
from maidenflight.simulator.physics.dynamics import equivalent_lag
from maidenflight.simulator.policy_spec import PolicySpec

SEARCHED = [
    (name, bounds)
    for usual in (physical_bounds(crazyflie()), PAPER_BOUNDS)
    for name, bounds in usual.items()
]
PHYSICAL_ZERO = {name for name, (field, _) in COMPONENTS.items() if QUANTITIES[field].lower == 0.0}


def estimate(
    value: float, bounds: tuple[float, float] | None, interval: tuple[float, float] | None = None
) -> Estimate:
    return Estimate(value, interval or (value, value), (value,), 0.0, None, bounds)


def between(name: str, bounds: tuple[float, float], share: float) -> float:
    low, high = bounds
    return low * (high / low) ** share if is_logarithmic(name) else low + share * (high - low)


@pytest.mark.parametrize(("name", "bounds"), SEARCHED)
def test_a_value_at_a_bound_is_found_but_not_where_nature_ends(name, bounds):
    for bound in bounds:
        natural = bound == 0 and name in PHYSICAL_ZERO
        assert bound_reached(name, estimate(bound, bounds)) == (None if natural else bound)
        assert (name in at_bounds({name: estimate(bound, bounds)})) != natural
    for share in (0.05, 0.5, 0.95):
        value = between(name, bounds, share)
        assert bound_reached(name, estimate(value, bounds)) is None
        assert at_bounds({name: estimate(value, bounds)}) == {}
    assert bound_reached(name, estimate(bounds[1], None)) is None


def test_a_drone_that_hardly_flies_is_not_yet_at_the_bound():
    bounds = physical_bounds(crazyflie())["thrust_to_weight"]
    assert bound_reached("thrust_to_weight", estimate(1.06, bounds)) is None
    found = {"thrust_to_weight": estimate(bounds[0], bounds)}
    by_law, otherwise = (at_bounds(found, by_law)["thrust_to_weight"] for by_law in (True, False))
    assert "--bounds" not in by_law + otherwise
    assert "--battery-law" in by_law
    assert "--battery-law" not in otherwise


def test_a_battery_law_counts_only_where_it_gave_all_thrust():
    flight = calm(300)
    others = replace(flight, by_battery_law=False), calm(300, battery=np.full(300, np.nan))
    assert Problem.of([flight]).by_battery_law
    assert not any(Problem.of([flight, other]).by_battery_law for other in others)


@pytest.mark.parametrize(("name", "bounds"), SEARCHED)
def test_what_a_note_advises_is_accepted_and_wider(name, bounds):
    for bound in bounds:
        said = at_bounds({name: estimate(bound, bounds)}).get(name, "")
        advised = re.search(r"--bounds (\w+)=([^,]+),(\S+)", said)
        if advised is None:
            continue
        assert advised[1] == name
        low, high = float(advised[2]), float(advised[3])
        search_box([name], {name: (low, high)})
        assert low < bounds[0] or high > bounds[1]
        assert bound_reached(name, estimate(bound, (low, high))) is None


@given(st.sampled_from(SEARCHED), st.floats(0, 1), st.floats(0, 1))
def test_widened_bounds_are_physical_and_hold_the_old_ones(searched, one, other):
    name, (least, most) = searched
    low, high = (least + share * (most - least) for share in sorted((one, other)))
    if low == high:
        return
    for bound in (low, high):
        wider = widened(name, bound, (low, high))
        assert wider[0] <= low < high <= wider[1]
        quantity = QUANTITIES[COMPONENTS[name][0]]
        assert quantity.lower <= wider[0]
        assert wider[1] <= quantity.upper


def test_an_interval_that_is_cut_off_at_a_bound_is_said_once():
    inside = estimate(1.0, (0.0, 3.0), (0.0, 2.0))
    cut, reached = estimate(2.5, (0.0, 3.0), (1.0, 3.0)), estimate(3.0, (0.0, 3.0), (2.9, 3.0))
    found = {"drag_x": inside, "drag_y": cut, "drag_z": reached}
    assert list(cut_off(found)) == ["drag_y"]
    assert list(at_bounds(found)) == ["drag_z"]


def test_a_lag_that_is_seen_has_the_bounds_of_what_was_tried():
    searched = {"motor_time_constant": estimate(0.2495, (0.003, 0.5))}
    assert at_bounds(searched) == {}
    seen = equivalent_lag_estimates(searched)
    assert seen["motor_time_constant"].bounds == LAG_BOUNDS
    assert "--ignore" not in at_bounds(seen)["motor_time_constant"]
    both = searched | {"spin_down_ratio": estimate(3.0, (0.2, 5.0))}
    narrower = np.array(LAG_BOUNDS) / equivalent_lag(1.0, 3.0)
    bounds = equivalent_lag_estimates(both)["motor_time_constant"].bounds
    assert bounds == pytest.approx(tuple(narrower))
    asked = equivalent_lag_estimates({"motor_time_constant": estimate(0.06, (0.05, 0.06))})
    assert "--bounds" in at_bounds(asked)["motor_time_constant"]


def identified(value: float) -> DroneFile:
    return DroneFile(
        crazyflie(),
        {
            "latency": estimate(0.0, (0.0, 0.05)),
            "thrust_to_weight": estimate(value, (1.5, 2.5)),
        },
        Posterior({"thrust_to_weight": np.array([value])}),
        Source(4, 120.0, True, "subsampled", 60000.0),
        Search("replay", 5.0, 116, 60),
        name="mine.toml",
    )


def test_a_drone_at_a_bound_is_refused_by_parameter_and_bound():
    must_lie_within_bounds(identified(1.7))
    must_lie_within_bounds(DroneFile(crazyflie()))
    with pytest.raises(InputError, match=r"mine\.toml: thrust_to_weight = 2\.5 .* 2\.5.*--bounds"):
        must_lie_within_bounds(identified(2.5))


@pytest.fixture
def folder(tmp_path):
    policy_file.write_policy(
        tmp_path / "p" / "policy_1.json",
        policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(3,))),
    )
    identified(2.5).write(tmp_path / "narrow.toml")
    return tmp_path


@pytest.mark.parametrize(
    "command",
    [
        "train --drone {narrow} -o {made}",
        "predict {p} --drone {narrow} -o {made}.csv",
        "transfer {p} --reality {narrow} -o {made}",
        "envelope {p} --drone {narrow} -o {made}",
        "record --reality {narrow} -o {made}",
    ],
)
def test_what_flies_or_trains_refuses_it_in_one_line_unless_it_is_accepted(
    command: str, folder: Any, monkeypatch: Any, capsys: Any
) -> None:
    class Reached(Exception):
        pass

    def reached(*_: Any, **__: Any) -> None:
        raise Reached

    given = {
        "narrow": folder / "narrow.toml",
        "p": folder / "p",
        "made": folder / "made",
    }
    words = ["maidenflight", *(word.format(**given) for word in command.split())]
    for stage in (
        "training.train.train",
        "experiments.transfer.transfer",
        "flying.recording.record",
        "experiments.flight_times.predict_flight_times",
        "experiments.envelope.envelope",
    ):
        monkeypatch.setattr(f"maidenflight.{stage}", reached)
    monkeypatch.setattr("sys.argv", words)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "narrow.toml: thrust_to_weight = 2.5" in line
    monkeypatch.setattr("sys.argv", [*words, "--accept-bounds"])
    with pytest.raises(Reached):
        cli.main()
