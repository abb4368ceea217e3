"""Which parameters flights can tell: those that were planted are chosen, and what buys nothing is
left out."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import planted
from maidenflight.identification.identify import identify
from maidenflight.identification.likelihood import selection
from maidenflight.identification.likelihood.observation import BY_MOMENT
from maidenflight.identification.likelihood.selection import FIRST, GROUPS, Parts
from maidenflight.identification.methods import Likelihood
from maidenflight.identification.outcome.progress import CHOICE, INTERVALS, STAGES
from maidenflight.identification.search.gauss_newton import NormalEquations
from maidenflight.parameters import COMPONENTS, component, replace

FEW = {name: GROUPS[name] for name in ("flapping_moment", "spin_down_ratio", "rotor_momentum")}
choose: Any = selection.choose
"""Also of stand-ins for a drone and its flights."""
PLANTED = {"spin_down_ratio": 1.8, "rotor_momentum": 3e-5}
TRIM = {"torque_bias_y": 8e-5}


@pytest.fixture(scope="module")
def found():
    """Chosen from 100 s of flight of a drone with noisy motors and sensors, and the steps as they
    were told."""
    truth = replace(planted.drone(1.75, 0.07, 0.012), actuator_noise=0.019, **PLANTED, **TRIM)
    flights = planted.with_noise(planted.logs(truth, 48, seed=1), seed=1)
    told = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selection, "GROUPS", FEW)
        patch.setattr(selection, "groups", lambda flights, has_measured_lag: FEW)
        return identify(flights, Likelihood(trials=1), over="auto", on_progress=told.append), told


@pytest.mark.slow
def test_what_was_planted_is_chosen_and_what_buys_nothing_is_not(found):
    identified, told = found
    assert {step.group: step.is_in_model for step in identified.gains} == {
        "spin_down_ratio": True,
        "rotor_momentum": True,
        "flapping_moment": False,
    }
    assert list(dict.fromkeys(now.gain for now in told if now.gain)) == list(identified.gains)
    assert set(identified.estimates) - set(BY_MOMENT) == {*FIRST, *PLANTED}
    assert not np.any(identified.parameters.flapping_moment)
    low, high = identified.estimates["torque_bias_y"].interval
    assert 0.0 < low < TRIM["torque_bias_y"] < high
    for step in identified.gains:
        assert (step.log_likelihood_gain > 0.05) == step.is_in_model
        assert 0 < step.standard_error < 0.02


@pytest.mark.slow
def test_a_curved_thrust_does_not_pass_for_inertia(monkeypatch):
    start = planted.drone(1.75, 0.07, 0.012)
    inertia = (np.array([1.2, 1.2, 0.8]) * start.inertia).astype(np.float32)
    curved = replace(start, thrust_linear=0.3, inertia=inertia)
    flights = planted.logs(curved, 48)
    offered = {"inertia": GROUPS["inertia"], **selection.OF_HELD_COMMANDS}
    monkeypatch.setattr(selection, "groups", lambda flights, has_measured_lag: offered)
    identified = identify(flights, Likelihood(trials=1), start=start, over="auto")
    for name in ("thrust_linear", "inertia_x", "inertia_y"):
        truth = float(component(curved, name))
        low, high = identified.estimates[name].interval
        assert low < truth < high
        assert identified.estimates[name].value == pytest.approx(truth, rel=0.05)


@pytest.mark.slow
def test_progress_goes_through_the_stages_in_order(found):
    _, told = found
    assert list(dict.fromkeys(now.stage for now in told)) == list(STAGES)
    evaluations = [now.evaluations for now in told]
    assert evaluations == sorted(evaluations)
    last = {now.stage: now for now in told}
    assert (last[CHOICE].done, last[CHOICE].of) == (len(FEW), len(FEW))
    assert (last[INTERVALS].done, last[INTERVALS].of) == (2, 2)


@pytest.mark.slow
def test_nothing_is_found_that_flights_did_not_change(found):
    identified, _ = found
    for name in identified.estimates:
        width = np.ptp(identified.expected[name].prior)
        assert np.std(identified.posterior[name]) < 0.9 * width / np.sqrt(12)


@pytest.mark.slow
def test_what_was_chosen_has_the_planted_values(found):
    estimates = found[0].estimates
    assert estimates["spin_down_ratio"].value == pytest.approx(1.8, rel=0.06)
    assert estimates["rotor_momentum"].value == pytest.approx(3e-5, rel=0.12)
    assert estimates["thrust_to_weight"].value == pytest.approx(1.75, rel=0.01)
    assert estimates["motor_time_constant"].value + estimates["latency"].value == pytest.approx(
        0.082, abs=0.003
    )


def test_groups_are_components_and_each_is_in_one_group():
    names = [*FIRST, *(name for group in GROUPS.values() for name in group)]
    assert set(names) <= set(COMPONENTS)
    assert len(set(names)) == len(names)


class Quadratic:
    """Minus log likelihoods of S segments, each quadratic in the components, instead of
    `OneStep`."""

    def __init__(
        self,
        optimum: dict[str, float],
        curvature: np.ndarray,
        segments: int = 12,
        scatter: float = 0.0,
    ):
        self.optimum, self.curvature = optimum, curvature
        self.rows_per_segment = np.full(segments, 100.0)
        self.wobble = scatter * np.random.default_rng(0).normal(size=segments)

    def _apart(self, drone: Any) -> np.ndarray:
        return np.array([drone[name] - value for name, value in self.optimum.items()])

    def per_segment(self, drone: Any, noise: Any) -> np.ndarray:
        apart = self._apart(drone)
        return self.rows_per_segment * 0.5 * (apart @ self.curvature @ apart) * (1 + self.wobble)

    def noise_model(self, drone: Any) -> None:
        return None

    def normal_equations(self, drone: Any, names: Any) -> NormalEquations:
        place = [list(self.optimum).index(name) for name in names]
        apart = self._apart(drone)
        curvature = self.curvature[np.ix_(place, place)]
        return NormalEquations(0.0, (self.curvature @ apart)[place], curvature, curvature)

    def fit(self, names: Any, first: Any) -> Any:
        """The lowest point with the other components kept."""
        moving = [list(self.optimum).index(name) for name in names]
        kept = [i for i in range(len(self.optimum)) if i not in moving]
        apart = self._apart(first)
        apart[moving] = -np.linalg.solve(
            self.curvature[np.ix_(moving, moving)],
            self.curvature[np.ix_(moving, kept)] @ apart[kept],
        )
        return dict(zip(self.optimum, apart + np.array(list(self.optimum.values())), strict=True))


def parts(training: Any, held_out: Any = None) -> Parts:
    """Flights to fit and to judge by, the same unless told otherwise."""
    return Parts(training, held_out or training, training)


def quadratic(generator, scales):
    root = generator.normal(size=(len(scales), len(scales)))
    return (root @ root.T + 0.5 * np.eye(len(scales))) / np.outer(scales, scales)


@given(st.integers(0, 1000))
def test_what_a_group_promises_is_what_a_quadratic_gains(seed):
    """The exact gain, from the values at both minima, of parameters in units far apart."""
    generator = np.random.default_rng(seed)
    names = (*FIRST, "drag_x", "drag_y", "rotor_momentum")
    scales = np.array([1.0, 0.1, 0.01, 0.3, 0.3, 1e-5])
    truth = Quadratic(
        dict(zip(names, scales * generator.normal(size=6), strict=True)),
        quadratic(generator, scales),
    )
    before = truth.fit(FIRST, dict.fromkeys(names, 0.0))
    equations = truth.normal_equations(before, names)
    for group in (("drag_x", "drag_y"), ("rotor_momentum",)):
        after = truth.fit((*FIRST, *group), before)
        gain = (truth.per_segment(before, None) - truth.per_segment(after, None))[0] / 100
        promise = selection._promise(
            equations.gradient, equations.curvature, names, (*FIRST, *group)
        )
        assert promise == pytest.approx(gain, rel=1e-5, abs=1e-9)


def test_groups_are_tried_by_what_they_promise_and_kept_by_what_they_gain():
    """By hand: uncoupled parameters promise c x^2 / 2; flights held out, whose best `c` is another,
    lose by the second of them."""
    names = (*FIRST, "a", "b", "c")
    curvature = np.diag([1.0, 1.0, 1.0, 2.0, 8.0, 4.0])
    training = Quadratic(dict.fromkeys(names, 1.0), curvature)
    held_out = Quadratic(dict.fromkeys(names, 1.0) | {"c": 0.49}, curvature, scatter=0.1)
    told: list[Any] = []
    groups = {name: (name,) for name in "cab"}
    chosen, drone, steps = choose(
        parts(training, held_out),
        training.fit,
        dict.fromkeys(names, 0.0),
        offered=groups,
        on_group=told.append,
    )
    assert chosen == (*FIRST, "b", "a")
    assert [(step.group, step.is_in_model) for step in steps] == [
        ("b", True),
        ("c", False),
        ("a", True),
    ]
    assert told == steps
    assert drone == {
        "thrust_to_weight": 1,
        "motor_time_constant": 1,
        "latency": 1,
        "a": 1,
        "b": 1,
        "c": 0,
    }, "what was not kept did not move"
    wobble = 1 + held_out.wobble.mean()
    expected = [4.0 * wobble, 2.0 * (0.49**2 - 0.51**2) * wobble, 1.0 * wobble]
    np.testing.assert_allclose([step.log_likelihood_gain for step in steps], expected, rtol=1e-6)


@pytest.mark.parametrize(("gain", "kept"), [(0.5e-3, False), (2e-3, True)])
def test_a_sure_gain_must_be_worth_its_place(gain, kept):
    names = (*FIRST, "a")
    truth = Quadratic(dict.fromkeys(names, 1.0), np.diag([1.0, 1.0, 1.0, 2 * gain]))
    _, _, (step,) = choose(
        parts(truth), truth.fit, dict.fromkeys(names, 0.0), offered={"a": ("a",)}
    )
    assert step.log_likelihood_gain == pytest.approx(gain)
    assert (step.is_in_model, step.reason) == (kept, None if kept else "below 0.001")


def test_a_group_that_ends_at_a_bound_is_not_kept():
    names = (*FIRST, "a", "b")
    truth = Quadratic(dict.fromkeys(names, 1.0), np.diag([1.0, 1.0, 1.0, 4.0, 2.0]))
    chosen, drone, steps = choose(
        parts(truth),
        truth.fit,
        dict.fromkeys(names, 0.0),
        offered={"a": ("a",), "b": ("b",)},
        at_bounds=lambda drone, names: ["a"] if names == ("a",) and drone["a"] > 0.5 else [],
    )
    assert chosen == (*FIRST, "b")
    kept = [(step.group, step.is_in_model, step.reason) for step in steps]
    assert kept == [("a", False, "a at a search bound"), ("b", True, None)]
    assert drone["a"] == 0.0


@pytest.mark.parametrize(("group", "is_added"), [("drag", False), ("flapping_moment", True)])
def test_a_gain_that_segments_do_not_agree_on_is_not_believed(group, is_added):
    """Five segments gain and five lose nearly as much: a mean of a hundredth a row, with a
    standard error of a third. What every drone has is added all the same."""
    gains = np.array([101.0] * 5 + [-99.0] * 5)
    held_out = SimpleNamespace(rows_per_segment=np.full(10, 100.0))
    values = iter((gains, np.zeros(10)))
    held_out.per_segment = lambda drone, noise: next(values)
    training = Quadratic(dict.fromkeys((*FIRST, "a"), 1.0), np.eye(4))
    names, _, (step,) = choose(
        parts(training, held_out),
        training.fit,
        dict.fromkeys((*FIRST, "a"), 0.0),
        offered={group: ("a",)},
    )
    assert step.log_likelihood_gain == pytest.approx(0.01)
    assert step.standard_error == pytest.approx(1 / 3, rel=0.01)
    assert (names == (*FIRST, "a")) == step.is_in_model == is_added


def test_the_standard_error_of_equal_segments_is_the_textbooks():
    gain = np.random.default_rng(1).normal(3.0, 2.0, 40)
    mean, error = selection._mean_gain(gain, np.full(40, 50.0))
    assert mean == pytest.approx(gain.mean() / 50)
    assert error == pytest.approx(gain.std(ddof=1) / np.sqrt(40) / 50)


def test_the_standard_error_of_unequal_segments_is_how_much_means_scatter():
    """Two thousand draws of thirty segments of unequal length."""
    generator = np.random.default_rng(2)
    rows = generator.integers(20, 200, 30).astype(float)
    draws = [
        selection._mean_gain(0.01 * rows + np.sqrt(rows) * generator.normal(size=30), rows)
        for _ in range(2000)
    ]
    means, errors = np.array(draws).T
    assert means.mean() == pytest.approx(0.01, abs=0.005)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(means.std(), rel=0.06)


def test_drag_is_looked_for_only_where_the_drone_moves():
    still, moving = (
        dataclasses.replace(log, velocity=speed * np.ones_like(log.velocity))
        for log, speed in zip(
            planted.logs(planted.drone(1.9, 0.06, 0.012), 2), (0.02, 0.3), strict=True
        )
    )
    assert not {"drag", "flapping_moment"} & set(selection.groups([still], has_measured_lag=False))
    sampled = dataclasses.replace(moving, zero_order_hold=False)
    # Noise that samples fold passes for inertia.
    less = {group: names for group, names in GROUPS.items() if group != "inertia"}
    assert selection.groups([sampled], has_measured_lag=False) == less
    every = GROUPS | selection.OF_HELD_COMMANDS
    assert selection.groups([moving], has_measured_lag=False) == every
    assert selection.groups([moving], has_measured_lag=True) == selection.WITH_KNOWN_LAG
