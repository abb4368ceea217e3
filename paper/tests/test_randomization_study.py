"""The study of randomizations: its statistics, its boxes, and the whole of it on little."""

import dataclasses
import math
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import polars
import pytest

from maidenflight import parameters
from maidenflight.experiments.conditions import CURRENT
from maidenflight.experiments.drones import distribution_of
from maidenflight.experiments.flight_times import predict_flight_times
from maidenflight.identification.drone_file import DroneFile, Estimate, Search, Source
from maidenflight.identification.posterior import Posterior
from maidenflight.policy import untrained_policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import randomize
from scripts import script


@pytest.fixture(scope="module")
def study() -> Any:
    return script("randomization")


@pytest.fixture(scope="module")
def cells(study: Any) -> Any:
    return sys.modules["randomization_policies"]


@pytest.fixture(scope="module")
def shares(study: Any) -> Any:
    return sys.modules["randomization_shares"]


def flights(
    control: str, randomization: str, place: str, shares: Sequence[float]
) -> polars.DataFrame:
    """Four flights a policy, of which a share reaches 20 s and the others tilt after 8 s."""
    rows = [
        {
            "control": control,
            "randomization": randomization,
            "number": number,
            "place": place,
            "trial": trial,
        }
        | (
            {"duration": 20.0, "end_reason": "time limit"}
            if trial <= 4 * share
            else {"duration": 8.0, "end_reason": "tilt"}
        )
        for number, share in enumerate(shares, 1)
        for trial in range(1, 5)
    ]
    return polars.DataFrame(rows)


def test_intervals_are_over_policies(shares: Any) -> None:
    """Student's for three and Welch's for three against two, by hand."""
    found = shares.average(np.array([0.5, 0.75, 1.0]))
    half = 4.302653 * 0.25 / math.sqrt(3)
    np.testing.assert_allclose(found, (0.75, 0.75 - half, 0.75 + half), rtol=1e-6)
    assert str(shares.average(np.array([1.0, 1.0]))) == "1.00 [1.00, 1.00]"
    assert str(shares.average(np.array([0.25]))) == "0.25"
    more = shares.compare_means(np.array([0.25, 0.25, 0.25]), np.array([0.5, 1.0]))
    half = 12.7062047 * 0.25  # the first do not differ, so that one degree of freedom is left
    np.testing.assert_allclose(more, (0.5, 0.5 - half, 0.5 + half), rtol=1e-6)
    assert str(shares.compare_means(np.ones(3), np.zeros(3))) == "-1.00"


def test_the_best_policy_is_the_one_whose_worst_place_is_best(shares: Any) -> None:
    """A place of another firmware does not count; a policy may be good in the mean and miss the bar
    all the same."""
    table = polars.concat(
        [
            flights("pwm", "none", "posterior", [1.0, 1.0]),
            flights("pwm", "none", "virtual:1", [0.25, 0.75]),
            flights("pwm", "box", "posterior", [1.0, 0.5]),
            flights("pwm", "box", "virtual:1", [1.0, 0.5]),
            flights("attitude", "box", "posterior", [0.75, 1.0]),
            flights("attitude", "box", "posterior 2021.10", [1.0, 0.0]),
            flights("attitude", "box", "virtual:1", [0.5, 0.75]),
        ]
    )
    assert shares.find_best_policies(table, 20.0).rows() == [
        ("pwm", "box 1", 1.0, "yes"),
        ("attitude", "box 2", 0.75, "no: virtual:1 0.75"),
    ]
    told = shares.summarize(table, 20.0).row(1, named=True)
    assert (told["place"], told["policies"], told["flights"]) == ("virtual:1", 2, 8)
    assert told["share of 20 s"] == "0.50 [0.00, 1.00]"
    assert (told["worst policy"], told["mean [s]"], told["most end by"]) == (0.25, 14.0, "tilt (4)")
    (posterior, virtual) = shares.compare_randomizations(
        table.filter(polars.col("control") == "pwm"), 20.0
    ).rows(named=True)
    assert posterior["box - none"].startswith("-0.25 [")
    assert virtual["box - none"].startswith("0.25 [")


def identified(folder: Path) -> Path:
    """A drone's file as `identify` writes it, with two drones of the posterior and two trims."""
    estimates = {
        "torque_bias_x": Estimate(0.0, (-1e-6, 1e-6), (0.0,), 1e-5),
        "torque_bias_z": Estimate(0.0, (-1e-6, 1e-6), (0.0,), 2e-5),
    }
    samples = {"thrust_to_weight": np.array([1.6, 1.7]), "latency": np.array([0.01, 0.012])}
    return DroneFile(
        parameters.crazyflie(),
        estimates,
        Posterior(samples),
        Source(3, 90.0, False, "zero-order-hold", 60000.0),
        Search("likelihood", -15.0, 80, 3),
    ).write(folder / "drone.toml")


@pytest.mark.slow
def test_drones_of_each_randomization_and_the_task_of_the_recipe(
    cells: Any, tmp_path: Path
) -> None:
    file, drone = str(identified(tmp_path)), parameters.crazyflie()
    keys = jax.random.split(jax.random.key(0), 200)

    def drawn(name: str) -> Any:
        distribution = distribution_of(file, cells.RANDOMIZATIONS[name], control.attitude())
        np.testing.assert_allclose(distribution.centre.time_step, 0.002)
        return jax.vmap(partial(randomize, distribution))(keys)

    np.testing.assert_array_equal(drawn("none").mass, drone.mass)
    assert 0.8 < np.ptp(drawn("box").mass) / (0.2 * drone.mass) <= 1.0
    assert set(np.round(drawn("posterior").thrust_to_weight.tolist(), 3)) == {1.6, 1.7}
    reach, most = np.array([1e-5, 0.0, 2e-5]), np.abs(drawn("recipe").torque_bias).max(axis=0)
    assert np.all((0.85 * reach <= most) & (most <= 1.0001 * reach))
    unknown = parameters.write_drone(tmp_path / "plain.toml", drone)
    plain = jax.vmap(partial(randomize, distribution_of(unknown, "wide", control.pwm())))(keys)
    assert not np.any(plain.torque_bias)
    assert "yaw penalty" not in cells.choose_task("box").name
    assert "yaw penalty" in cells.choose_task("recipe").name


@pytest.mark.night
def test_policies_train_and_fly_and_a_second_run_draws_from_the_tables(
    study: Any, cells: Any, tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = cells.AnalyticGradient(updates=1, num_envs=2, horizon=2, episodes=2)
    monkeypatch.setattr(study, "QUICK", {"pwm": settings})
    monkeypatch.setattr(cells, "QUICK", {"pwm": settings})
    made = tmp_path / "made"
    few = [
        "--seeds",
        "2",
        "--flights",
        "3",
        "--trials",
        "2",
        "--duration",
        "0.3",
        "--randomization",
        "posterior",
    ]
    arguments = [
        "--drone",
        str(identified(tmp_path)),
        "-o",
        str(made),
        "--control",
        "pwm",
        *few,
        "--realities",
        "virtual:1",
    ]
    study.main(arguments)
    table = polars.read_csv(made / "flights.csv", comment_prefix="#")
    assert table.columns == [
        "control",
        "randomization",
        "number",
        "place",
        "trial",
        "duration",
        "end_reason",
    ]
    assert table.group_by("place", maintain_order=True).len().rows() == [
        ("posterior", 6),
        ("trim", 6),
        ("virtual:1", 4),
    ]
    assert table["duration"].is_between(0.01, 0.3).all()
    assert ">pwm</text>" in (made / "randomization.svg").read_text()
    assert "share of 20 s" in capsys.readouterr().out

    def never(*_: Any, **__: Any) -> None:
        raise AssertionError("all is there")

    for owner, name in ((cells, "train"), (study, "predict_flight_times"), (study, "transfer")):
        monkeypatch.setattr(owner, name, never)
    before = {path: path.read_bytes() for path in made.rglob("*") if path.is_file()}
    study.main(arguments)
    assert {path: path.read_bytes() for path in made.rglob("*") if path.is_file()} == before
    for other in (["--updates", "2"], ["--flights", "4"]):
        with pytest.raises(SystemExit):
            study.main([*arguments, *other])
        assert "other" in capsys.readouterr().err


def test_what_cannot_be_done_is_told_before_training(
    study: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(identified(tmp_path))
    cases = {
        "no such file": ["--drone", "crazyflie"],
        "at least one": ["--drone", file, "--seeds", "0"],
        "virtual:SEED": ["--drone", file, "--realities", "virtual:x"],
    }
    for words, arguments in cases.items():
        with pytest.raises(SystemExit):
            study.main([*arguments, "-o", str(tmp_path / "made")])
        assert words in capsys.readouterr().err
    assert not (tmp_path / "made").exists()


@pytest.mark.night
def test_policies_fly_under_the_structure_that_is_asked_for() -> None:
    """One that turns the motors off: the drone falls 0.25 m within half a second."""
    hover = 2 * float(dynamics.hover_command(parameters.crazyflie())) - 1
    spec = PolicySpec(hidden=(8,))
    made = jax.tree.map(jnp.zeros_like, untrained_policy(jax.random.key(0), spec=spec))
    hovering = dataclasses.replace(
        made, biases=(made.biases[0], jnp.full(4, hover)), observation_std=jnp.ones(40)
    )

    def off(memory: None, *_: Any) -> tuple[None, jax.Array]:
        return memory, jnp.zeros(4)

    near = CURRENT._replace(guard=CURRENT.guard._replace(position_error=0.25))
    structures = {
        "default": near,
        "current": near._replace(controller_for=control.controller_for),
        "off": near._replace(
            controller_for=lambda one: control.controller_for(one)._replace(command=off)
        ),
    }
    flown = {
        name: predict_flight_times(
            *([hovering], parameters.crazyflie(), jax.random.key(0)),
            trials=2,
            duration=1.0,
            conditions=one,
        )
        for name, one in structures.items()
    }
    assert flown["default"].equals(flown["current"])
    assert (flown["default"]["duration"] > 0.45).all()
    assert flown["off"]["duration"].is_between(0.2, 0.45).all()
    assert flown["off"]["end_reason"].to_list() == ["position error"] * 2
