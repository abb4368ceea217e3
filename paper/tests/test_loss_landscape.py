"""The loss landscape: contours are those of the objective, and odd evaluations are refused."""

from pathlib import Path

import numpy as np
import polars
import pytest

from maidenflight.errors import InputError
from maidenflight.identification.drone_file import Estimate
from reporting.drawn import of, rows
from scripts import script

landscape = script("loss_landscape")
BEST = np.array([1.7, 0.080, 0.014])
NAMES = ["thrust_to_weight", "motor_time_constant", "latency"]
HESSIAN = np.array([[9.0, 3.0, 1.0], [3.0, 6.0, 2.0], [1.0, 2.0, 4.0]]) / np.outer(
    [0.03, 0.004, 0.001], [0.03, 0.004, 0.001]
)
ESTIMATES = {
    name: Estimate(float(value), (float(0.98 * value), float(1.03 * value)), (float(value),), 0.0)
    for name, value in zip(NAMES, BEST, strict=True)
}


def search(count=200, wide=1.0):
    """Evaluations of a quadratic with its minimum, 60, at BEST."""
    points = BEST + np.random.default_rng(0).normal(size=(count, 3)) * wide * [0.01, 0.0015, 0.0004]
    points[0] = BEST
    rise = np.einsum("ni,ij,nj->n", points - BEST, HESSIAN, points - BEST) / 2
    return polars.DataFrame(
        {
            "trial": [0] * count,
            **dict(zip(NAMES, points.T, strict=True)),
            "objective": 60 * (1 + rise / 100),
        }
    )


def test_every_evaluation_is_a_dot_and_the_optimum_is_marked():
    figure, note = landscape.loss_landscape(search(), ESTIMATES, [(0.08, 0.014), (0.1, 0.02)])
    assert len(of(figure, mark="identified")) == 1
    assert "fitted to the" in note
    assert sum(row["series"] in ("low", "middle", "high") for row in rows(figure)) == 200


def test_a_contour_is_where_the_objective_is_that_much_higher_with_the_others_at_their_best():
    found = landscape.valley(
        search().select(NAMES).to_numpy(), search()["objective"].to_numpy(), [1, 2]
    )
    assert found is not None
    assert found.error < 1e-6
    assert abs(found.lowest) < 1e-6
    np.testing.assert_allclose(found.centre, BEST[1:], rtol=1e-6)
    for place in found.contour(BEST[1:], 1.0)[::10] - BEST[1:]:
        other = -HESSIAN[0, 1:] @ place / HESSIAN[0, 0]
        whole = np.array([other, *place])
        np.testing.assert_allclose(whole @ HESSIAN @ whole / 2, 1.0, rtol=1e-4)


@pytest.mark.parametrize(
    "rows",
    [
        search(12),
        search().with_columns(latency=polars.lit(0.018)),
        search().with_columns(objective=polars.lit(60.0)),
        search().with_columns(objective=120 - polars.col("objective").clip(0, 62)),
        search().with_columns(objective=60 + (polars.col("latency") - 0.014).abs() * 1e4),
        search(1),
    ],
    ids=["few", "on a line", "flat", "a hill", "a kink", "one"],
)
def test_no_contours_where_no_quadratic_fits(rows):
    figure, note = landscape.loss_landscape(rows)
    assert "No contours" in note
    assert of(figure, series="contours") == []
    assert len(of(figure, mark="best evaluation")) == 1


def test_a_table_without_a_valley_is_refused():
    with pytest.raises(InputError, match="no column latency"):
        landscape.loss_landscape(search().drop("latency"))
    with pytest.raises(InputError, match="finite objective"):
        landscape.loss_landscape(search().with_columns(objective=polars.lit(float("nan"))))
    with pytest.raises(InputError, match="likelihoods"):
        landscape.loss_landscape(search().with_columns(objective=polars.col("objective") - 61))


def test_the_evaluations_of_a_file_are_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    search().write_csv(tmp_path / "identification.csv")
    landscape.main([str(tmp_path / "identification.csv"), "-o", str(tmp_path / "made.svg")])
    assert "fitted to the" in capsys.readouterr().out
    assert "within 1 % of the best" in (tmp_path / "made.svg").read_text()
