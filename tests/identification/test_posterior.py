"""Joint samples of parameters: they stay together, and know what they hold."""

from pathlib import Path

import jax
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.identification.posterior import Posterior
from maidenflight.parameters import crazyflie, replace
from maidenflight.reporting.figures.plots import Picture

GENERATOR = np.random.default_rng(0)
LAG = 0.06 + 0.002 * GENERATOR.normal(size=400)
POSTERIOR = Posterior({"motor_time_constant": LAG, "latency": 0.08 - LAG})


def test_it_is_a_mapping_of_samples_by_parameter() -> None:
    assert list(POSTERIOR) == ["motor_time_constant", "latency"]
    assert (len(POSTERIOR), POSTERIOR.size) == (2, 400)
    assert not Posterior({})
    assert Posterior({}).size == 0
    with pytest.raises(InputError):
        Posterior({"latency": LAG, "drag_x": LAG[1:]})


def test_what_is_drawn_belongs_together() -> None:
    few, many = POSTERIOR.sample(50), POSTERIOR.sample(1000, jax.random.key(1))
    for some in (few, many):
        np.testing.assert_allclose(some["motor_time_constant"] + some["latency"], 0.08)
    assert (few.size, many.size) == (50, 1000)
    assert len(np.unique(few["latency"])) == 50
    with pytest.raises(InputError):
        Posterior({}).sample(1)


def test_its_summary_has_units_and_intervals() -> None:
    row = POSTERIOR.summary().row(0, named=True)
    assert (row["parameter"], row["unit"]) == ("motor_time_constant", "s")
    np.testing.assert_allclose([row["low"], row["high"]], np.quantile(LAG, [0.025, 0.975]))
    assert row["sd"] == pytest.approx(0.002, rel=0.1)
    assert "latency" in repr(POSTERIOR)


def test_truths_have_ranks() -> None:
    row = POSTERIOR.coverage({"latency": 0.0, "mass": 1.0}).row(0, named=True)
    assert (row["rank"], row["is_held"]) == (0.0, False)
    assert row["z"] == pytest.approx(-10.0, rel=0.1)
    drone = replace(crazyflie(), motor_time_constant=0.06, latency=0.02)
    rows = POSTERIOR.coverage(drone)
    assert rows["is_held"].to_list() == [True, True]
    np.testing.assert_allclose(rows["rank"], 0.5, atol=0.05)


def test_ranks_of_draws_are_uniform() -> None:
    ranks = [POSTERIOR.coverage({"latency": one})["rank"][0] for one in POSTERIOR["latency"]]
    np.testing.assert_allclose(np.quantile(ranks, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.02)


def test_a_file_has_the_same_samples(tmp_path: Path) -> None:
    path = tmp_path / "posterior.csv"
    POSTERIOR.write(path)
    again = Posterior.read(path)
    assert list(again) == list(POSTERIOR)
    np.testing.assert_allclose(again["latency"], POSTERIOR["latency"], rtol=1e-12)
    path.write_text("mass,colour\n1,2\n")
    with pytest.raises(InputError):
        Posterior.read(path)
    with pytest.raises(InputError):
        Posterior.read(tmp_path / "none.csv")


def test_it_shows_itself() -> None:
    assert isinstance(POSTERIOR.plot_corner({"latency": 0.02}), Picture)
    assert POSTERIOR.to_polars().shape == (400, 2)


def test_other_libraries_take_it() -> None:
    pytest.importorskip("pandas")
    assert POSTERIOR.to_pandas().shape == (400, 2)


def test_arviz_takes_it() -> None:
    pytest.importorskip("arviz")
    assert POSTERIOR.to_arviz()["posterior"]["latency"].shape == (1, 400)
