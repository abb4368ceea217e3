"""The estimator on a model of two lines, whose answer is in every textbook."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from maidenflight.identification.likelihood import other_ways
from maidenflight.identification.likelihood.estimator import (
    Answer,
    Question,
    answer_question,
)
from maidenflight.identification.likelihood.laplace import Others
from maidenflight.identification.likelihood.observation import NoiseModel, ObservationModel
from maidenflight.identification.likelihood.selection import SMALLEST_GAIN, Parts
from maidenflight.identification.methods import Likelihood
from maidenflight.identification.outcome.problem import Problem
from maidenflight.identification.outcome.progress import Reporter
from maidenflight.parameters import Parameters, component, crazyflie, replace

NAMES = ("drag_x", "drag_y", "drag_z")
TRUTH = {"drag_x": 1.0, "drag_y": 2.0, "drag_z": 0.0}
START = replace(crazyflie(), drag=np.array([0.2, 0.3, 0.0], np.float32))


class Lines(ObservationModel):
    """White noise of deviation 0.1 about the sum of three parameters times a cause each."""

    def __init__(self, seed: int, segments: int = 40):
        generator = np.random.default_rng(seed)
        self.causes = generator.normal(size=(segments, 50, 3)) @ np.diag([1.0, 0.5, 0.3])
        self.causes[..., 1] += 0.3 * self.causes[..., 0]
        self.measured = self.causes @ [*TRUTH.values()] + 0.1 * generator.normal(
            size=(segments, 50)
        )
        self.rows_per_segment = np.full(segments, 50.0)

    def errors(self, drone: Parameters) -> np.ndarray:
        return self.measured - self.causes @ np.asarray(drone.drag, float)

    def noise_model(self, parameters: Parameters) -> NoiseModel:
        return NoiseModel(np.zeros((1, 0)), np.array([0.1]))

    def per_segment(self, parameters: Parameters, noise: NoiseModel) -> np.ndarray:
        return 0.5 * ((self.errors(parameters) / noise.deviation) ** 2).sum(axis=1)

    def derivatives(self, parameters: Parameters, names: Sequence[str]) -> tuple:
        causes = self.causes[..., [NAMES.index(name) for name in names]] / 0.1
        scores = -np.einsum("std,st->sd", causes, self.errors(parameters) / 0.1)
        curvatures = np.einsum("std,ste->sde", causes, causes)
        return self(parameters), scores / self.rows, curvatures / self.rows


class Waves(Lines):
    """A sine whose phase a latency turns: optima one period apart, under a slope to the truth."""

    period, truth = 0.02, 0.002
    times = np.linspace(0.0, 0.5, 50)

    def errors(self, drone: Parameters) -> np.ndarray:
        late = float(drone.latency) - self.truth
        wave = np.sin(2 * np.pi * (self.times - late) / self.period)
        true = np.sin(2 * np.pi * self.times / self.period)
        return np.tile(wave - true + 20.0 * late, (len(self.rows_per_segment), 1))

    def derivatives(self, parameters: Parameters, names: Sequence[str]) -> tuple:
        assert tuple(names) == ("latency",)
        errors = self.errors(parameters)
        late = float(parameters.latency) - self.truth
        turned = np.cos(2 * np.pi * (self.times - late) / self.period) * 2 * np.pi / self.period
        slopes = np.tile(20.0 - turned, (len(errors), 1))[..., None] / 0.1
        scores = np.einsum("std,st->sd", slopes, errors / 0.1)
        curvatures = np.einsum("std,ste->sde", slopes, slopes)
        return self(parameters), scores / self.rows, curvatures / self.rows


def test_a_start_of_another_latency_does_not_end_in_a_wave_that_is_not_the_truths() -> None:
    flights: Any = [SimpleNamespace(name="none")]
    source: Any = None
    start = replace(crazyflie(), latency=np.float32(0.026))
    problem = Problem(flights, source, start, None, {}, np.random.default_rng(3), Reporter(None))
    model = Waves(0)
    question = Question(model, ("latency",), start)
    found = answer_question(problem, Likelihood(trials=1), question)
    assert float(found.best.drone.latency) == pytest.approx(Waves.truth, abs=2e-5)


def answer(names: tuple[str, ...], trials: int = 1, **known: Any) -> Answer:
    flights: Any = [SimpleNamespace(name="none")]
    source: Any = None
    problem = Problem(flights, source, START, None, {}, np.random.default_rng(3), Reporter(None))
    model = Lines(0)
    question = Question(model, names, START, **known)
    return answer_question(problem, Likelihood(trials=trials), question)


def least_squares(columns: list[int], left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    causes = Lines(0).causes[..., columns].reshape(-1, len(columns))
    covariance = 0.01 * np.linalg.inv(causes.T @ causes)
    return covariance @ causes.T @ left.ravel() / 0.01, np.sqrt(np.diag(covariance))


def test_value_and_interval_are_those_of_least_squares() -> None:
    found = answer(NAMES[:2], trials=2)
    values, deviations = least_squares([0, 1], Lines(0).measured)
    for name, value, deviation in zip(NAMES, values, deviations, strict=False):
        assert component(found.best.drone, name) == pytest.approx(value, abs=0.1 * deviation)
        # Another flight of 30 s may differ by what segments do.
        wide = np.hypot(deviation, found.posterior.spread[name] / np.sqrt(6))
        assert found.samples[name].std() == pytest.approx(wide, rel=0.15)
        assert found.posterior.error[name] == pytest.approx(wide, rel=0.15)
    ends = [fit.points[int(np.argmin(fit.values))] for fit in found.fits]
    np.testing.assert_allclose(*ends, atol=1e-4)


def follows(found: Answer) -> None:
    """Where the first slope is larger the second is smaller, by the causes' regression."""
    one, other = (Lines(0).causes[..., place].ravel() for place in (0, 1))
    slope = np.polyfit(found.samples["drag_x"], found.samples["drag_y"], 1)[0]
    assert slope == pytest.approx(-(one @ other) / (other @ other), abs=0.15)


def test_what_is_seen_is_not_searched_for_and_the_rest_follows() -> None:
    shown = np.random.default_rng(1).normal(1.0, 0.1, 500)
    found = answer(NAMES[:2], samples={"drag_x": shown})
    assert found.best.drone.drag[0] == pytest.approx(np.median(shown), rel=1e-6)
    left = Lines(0).measured - np.median(shown) * Lines(0).causes[..., 0]
    assert found.best.drone.drag[1] == pytest.approx(least_squares([1], left)[0][0], abs=1e-3)
    follows(found)


def test_samples_of_another_sensor_are_followed_and_handed_on() -> None:
    shown = np.random.default_rng(1).normal(0.2, 0.1, 500)
    found = answer(NAMES[1:2], others=lambda drone: Others.from_samples({"drag_x": shown}, drone))
    assert list(found.samples) == ["drag_y", "drag_x"]
    np.testing.assert_array_equal(found.samples["drag_x"], shown)
    assert found.best.drone.drag[0] == START.drag[0]
    follows(found)


def test_doubt_widens_and_what_is_lost_keeps_the_start() -> None:
    plain = answer(NAMES[:2])
    wide = answer(NAMES[:2], doubt=lambda fit, others: np.diag([0.1**2, 0.0]))
    assert plain.samples["drag_x"].std() < 0.1 < wide.samples["drag_x"].std()
    assert wide.samples["drag_y"].std() == pytest.approx(plain.samples["drag_y"].std(), rel=0.1)
    lost = wide.without({"drag_x": (0.0, 2.0)}, START, np.random.default_rng(0))
    assert lost.best.drone.drag[0] == START.drag[0]
    assert lost.unidentifiable == {"drag_x": (0.0, 2.0)}
    assert np.ptp(lost.samples["drag_x"]) > 1.9


def test_a_parameter_is_surely_needed_where_the_starts_value_costs_likelihood() -> None:
    found = answer(NAMES[:2])
    _, _, curvatures = found.best.model.derivatives(found.best.drone, NAMES[:2])
    variance = np.linalg.inv(curvatures.sum(axis=0))[1, 1]
    value, off = component(found.best.drone, "drag_y"), np.sqrt(2 * SMALLEST_GAIN * variance)
    for change, needed in ((1.1 * off, {"drag_y"}), (0.9 * off, set())):
        start = replace(START, drag_y=np.float32(value - change))
        assert found.surely_needed(["drag_y"], start) == needed
        assert found.surely_needed([], start) == set()


@pytest.mark.parametrize("fitted", [("drag_x",), ("drag_x", "drag_y")])
def test_what_a_fit_lacks_is_what_least_squares_gain(fitted, monkeypatch) -> None:
    """Of drag_y, which was planted, as of drag_z, which was not."""
    lacking = NAMES[len(fitted)]
    monkeypatch.setattr(other_ways, "_LACKING", (lacking, *fitted))
    causes, left = Lines(0).causes.reshape(-1, 3), Lines(0).errors(START).ravel()
    without, added = (
        np.linalg.lstsq(causes[:, :count], left)[1][0] for count in (len(fitted), len(fitted) + 1)
    )
    gain = other_ways.what_is_lacking(answer(fitted).best)
    assert gain == pytest.approx((without - added) / 0.02, rel=1e-3, abs=0.05)
    assert (gain > 10) == (lacking == "drag_y")


def test_a_group_is_added_that_others_flights_want() -> None:
    parts = Parts(Lines(1), Lines(2), Lines(1))
    groups = {"right": ("drag_y",), "idle": ("drag_z",)}
    found = answer(NAMES[:1], parts=parts, groups=groups)
    assert [(gain.group, gain.is_in_model) for gain in found.gains] == [
        ("right", True),
        ("idle", False),
    ]
    assert found.best.box.names == ("drag_x", "drag_y")
