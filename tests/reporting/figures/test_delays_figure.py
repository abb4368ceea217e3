"""The posterior of the delays: ellipses hold their shares, and all is marked where it is."""

import numpy as np
import pytest

from drawn import of
from maidenflight.errors import InputError
from maidenflight.identification.drone_file import Estimate
from maidenflight.reporting.figures.delays import DELAYS, delay_posterior

ESTIMATES = {
    name: Estimate(value, (0.98 * value, 1.03 * value), (value,), 0.0)
    for name, value in zip(DELAYS, (0.080, 0.014), strict=True)
}


def draws(count: int = 4000) -> dict[str, np.ndarray]:
    lag, late = np.random.default_rng(3).normal(size=(2, count))
    return {"motor_time_constant": 0.08 + 1e-3 * lag, "latency": 0.014 + 1e-4 * late}


def ends(figure):
    """Ranges of the axes."""
    encoding = figure.panels[0]["layer"][0]["encoding"]
    return [encoding[axis]["scale"]["domain"] for axis in "xy"]


def test_the_ellipses_hold_their_shares_of_the_samples() -> None:
    figure = delay_posterior(draws(), ESTIMATES)
    points = np.array([[row["x"], row["y"]] for row in of(figure, series="sample")])
    centre = points.mean(axis=0)
    for share, name in ((0.5, "50 %"), (0.95, "95 %")):
        curve = np.array([[row["x"], row["y"]] for row in of(figure, curve=name)]) - centre
        axes = np.abs(curve).max(axis=0)
        inside = (((points - centre) / axes) ** 2).sum(axis=1) < 1
        assert inside.mean() == pytest.approx(share, abs=0.03)


def test_the_optimum_its_interval_truth_and_the_paper_are_marked() -> None:
    figure = delay_posterior(draws(400), ESTIMATES, [(0.08, 0.014), (0.1, 0.02)])
    [best] = of(figure, mark="identified")
    assert (best["x"], best["y"]) == pytest.approx((80.0, 14.0))
    [lag] = of(figure, bar="x")
    assert (lag["x"], lag["x2"], lag["y2"]) == pytest.approx((78.4, 82.4, 14.0))
    [paper] = of(figure, series="paper")
    (low_x, high_x), (low_y, high_y) = ends(figure)
    assert (paper["x"], paper["y"]) == pytest.approx((high_x, high_y), rel=0.01), "far: at the edge"
    assert 80.0 < high_x < 88.0
    points = of(figure, series="sample")
    reach = max(row["x"] for row in points) - min(row["x"] for row in points)
    assert reach > 0.6 * (high_x - low_x), "the cloud fills the picture"
    assert low_y < 14.0 < high_y
    assert any("88 ms, 18 ms" in entry.name for entry in figure.legend)
    assert [row["x"] for row in of(figure, series="truth")] == pytest.approx([80.0, 100.0, 80.0])
    assert all(row["x"] + row["y"] == pytest.approx(94.0) for row in of(figure, series="total"))


def test_a_posterior_without_one_of_the_delays_is_refused() -> None:
    with pytest.raises(InputError, match="no posterior"):
        delay_posterior({"latency": draws(9)["latency"]}, ESTIMATES)
