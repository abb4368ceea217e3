"""The script that tries the claims of the paper's Discussion runs, on little, and says what it
measured."""

import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars
import pytest

from maidenflight import policy
from maidenflight.experiments.transfer import transfer
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.controllers import control
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from maidenflight.simulator.tasks import tasks
from scripts import script


@pytest.fixture(scope="module")
def ablations() -> Any:
    return script("ablations")


@pytest.fixture(scope="module")
def training(ablations: Any) -> Any:
    return sys.modules["ablation_variants"]


@pytest.fixture(scope="module")
def effects(ablations: Any) -> Any:
    return sys.modules["ablation_effects"]


def test_variants_change_one_thing_and_each_control_structure_begins_with_its_baseline(
    training: Any,
) -> None:
    variants = training.VARIANTS
    assert len({one.folder for one in variants}) == len(variants)
    for structure in training.QUICK:
        own = [one for one in variants if one.control == structure]
        assert own[0] == training.Variant(structure)
        assert all(one[2:] != own[0][2:] for one in own[1:])
        assert own[0].controller() is control.CONTROLLERS[structure]()
    drone = replace(crazyflie(), latency=0.01)
    left_out = next(one for one in variants if one.name == "neither lag nor latency").drone(drone)
    assert (float(left_out.motor_time_constant), float(left_out.latency)) == (
        np.float32(training.NO_LAG),
        0.0,
    )
    free = next(one for one in variants if one.excess == 0.0)
    every = training.choose_variants(training.QUICK, "gradient")
    assert every == list(variants)
    assert training.choose_variants(training.QUICK, "ppo") == [
        one for one in variants if one is not free
    ]
    assert training.choose_settings(free, "gradient", None).action_excess_penalty == 0.0
    assert training.choose_settings(variants[0], "ppo", None).updates == training.PPO_UPDATES
    paper = training.choose_settings(variants[0], "ppo-paper", None)
    assert (paper.updates, paper.num_envs * paper.horizon) == (500, 64_000)
    wide = next(one for one in variants if one.name == "+-360 deg/s")
    assert wide.controller() is control.attitude_rate(highest_rate=360.0)
    assert (
        tasks.paper_circle(
            action_penalty=variants[0].action_penalty,
            action_rate_penalty=variants[0].action_rate_penalty,
        )
        is tasks.paper_circle()
    )


@pytest.mark.slow
def test_actions_are_told_from_a_flights_log(ablations: Any) -> None:
    """With PWM control commands are the actions, cut off at [-1, 1] and known to the step of the
    motors' timers."""
    drone = VirtualDrone("itself", replace(crazyflie(), time_step=0.001))
    made = policy.untrained_policy(jax.random.key(1), spec=PolicySpec(hidden=(8,)))
    lively = made.with_network(((made.weights[0], 3.0 * made.weights[1]), made.biases, None))
    # Flights of a shape that the script's own have, too, so that they compile once.
    flights = transfer([lively, lively], [drone], 2, duration=0.3).flights[:2]
    level = 2.0 * float(dynamics.hover_command(drone.parameters)) - 1.0
    both = ablations.rebuild_actions(lively, flights, np.full((2, 4), level))
    assert len(both[0]) != len(both[1])
    for done, flight in zip(both, flights, strict=True):
        assert len(done) == len(flight)
        np.testing.assert_allclose(
            (np.clip(done, -1.0, 1.0) + 1.0) / 2.0, flight.command, atol=0.015
        )
    assert np.abs(both[0]).max() > 1.0
    assert np.abs(both[0]).min() < 1.0


def test_activity_is_of_actions_and_commands(ablations: Any) -> None:
    done = np.array([[0.0, 1.5, -2.0, 1.0], [0.0, 0.0, 0.0, 0.0]])
    command = np.array([[0.5, 1.0, 0.0, 0.5], [0.5, 0.6, 0.4, 0.9]])
    measured = ablations.measure_activity(done, command)
    assert measured == pytest.approx((2 / 8, 1.2 / 4, 2 / 8))
    assert ablations.measure_activity(done[:1], command[:1]).change == 0.0


def test_drones_with_other_parts_differ_in_what_they_say(training: Any) -> None:
    drone, generator = crazyflie(), np.random.default_rng(3)
    made = [
        training.with_other_parts(drone, training.Parts({"thrust_to_weight": 0.1}, 0.05), generator)
        for _ in range(400)
    ]
    factors = np.array([float(one.thrust_to_weight / drone.thrust_to_weight) for one in made])
    assert factors.min() > 0.9
    assert factors.max() < 1.1
    assert np.std(factors) == pytest.approx(0.2 / np.sqrt(12), rel=0.1)
    trims = np.array([one.torque_bias for one in made])
    lever, hover = 0.0396 / np.sqrt(2), 0.028 * 9.81 / 4
    expected = 2 * 0.05 * hover * np.array([lever, lever, 5.96e-3])
    np.testing.assert_allclose(trims.std(axis=0), expected, rtol=0.12)
    np.testing.assert_allclose(trims.mean(axis=0), 0.0, atol=expected.max() / 5)


def told(
    variant: str, reality: str, durations: list[float], control: str = "pwm"
) -> list[dict[str, Any]]:
    one = {
        "variant": variant,
        "control": control,
        "reality": reality,
        "drone": 1,
        "trial": 1,
        "end_reason": "tilt",
    }
    rest = {"position_error": 0.01, "beyond": 0.0, "change": 0.02, "at_limits": 0.5}
    return [
        {**one, "policy": number, "duration": duration, **rest}
        for number, duration in enumerate(durations, 1)
    ]


def test_effects_are_of_policies_paired_where_they_are_the_same(effects: Any) -> None:
    rows = told("as the paper", "itself", [10.0, 12.0, 20.0]) + told(
        "no latency", "itself", [1.0, 2.0, 3.0]
    )
    rows += told("as the paper", "posterior", [9.0, 11.5, 19.0]) + told(
        "as the paper", "posterior", [9.0, 10.5, 19.0]
    )
    found = effects.find_effects(polars.DataFrame(rows)).filter(polars.col("measure") == "duration")
    assert found["policies"].to_list() == [3, 3, 3]
    assert found["effect"].to_list() == pytest.approx([0.0, -12.0, -1.0])
    baseline, unpaired, paired = found.iter_rows(named=True)
    assert np.isnan(baseline["low"])
    variances = np.var([10, 12, 20], ddof=1) / 3, 1 / 3
    freedom = sum(variances) ** 2 / sum(variance**2 / 2 for variance in variances)
    half = effects.stats.t.ppf(0.975, freedom) * np.sqrt(sum(variances))
    assert (unpaired["low"], unpaired["high"]) == pytest.approx((-12 - half, -12 + half))
    assert np.isnan(paired["low"]), "all policies lost a second"
    weighted = effects.average_policies(
        polars.DataFrame([*told("a", "b", [1.0]), {**told("a", "b", [3.0])[0], "change": 0.06}])
    )
    assert weighted["change"].item() == pytest.approx(0.05)


@pytest.mark.night
def test_variants_are_trained_flown_and_drawn_and_nothing_twice(
    ablations: Any,
    training: Any,
    tmp_path: Path,
    monkeypatch: Any,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Training itself, which takes longest to compile, is tested elsewhere."""
    settings = training.AnalyticGradient(updates=1)
    asked = []

    def train(
        task: Any, controller: Any, box: Any, keys: Any, settings: Any
    ) -> list[policy.Policy]:
        asked.append((task, controller, float(box.centre.latency), settings))
        spec = PolicySpec(hidden=(8,))
        return [policy.untrained_policy(key, controller.interface, spec) for key in keys]

    monkeypatch.setattr(training, "train", train)
    monkeypatch.setattr(training, "QUICK", {"pwm": settings})
    monkeypatch.setattr(training, "VARIANTS", (training.VARIANTS[0], training.VARIANTS[6]))
    monkeypatch.setattr(
        training,
        "PARTS",
        {name: training.PARTS[name] for name in ("other motors", "unequal motors, 5 %")},
    )
    arguments = [
        "--seeds",
        "2",
        "--trials",
        "2",
        "--draws",
        "1",
        "--duration",
        "0.3",
        "-o",
        str(tmp_path),
    ]
    ablations.main(arguments)
    data = polars.read_csv(tmp_path / "flights.csv", comment_prefix="#")
    assert asked == [
        (tasks.paper_circle(), control.pwm(), pytest.approx(latency), settings)
        for latency in (0.018, 0.0)
    ]
    assert data.height == 2 * 2 * (2 + 2 + 2)
    assert set(data["reality"]) == {"itself", "virtual:7", "other motors", "unequal motors, 5 %"}
    assert data["duration"].is_between(0.01, 0.3).all()
    output = capsys.readouterr().out
    for words in ("no latency", "other motors", "flight time [s]", "crazyflie has no posterior"):
        assert words in output
    picture = (tmp_path / "ablations.svg").read_bytes()
    assert b"pwm: trained otherwise" in picture

    def never(*_: Any, **__: Any) -> None:
        raise AssertionError("all of it is there")

    monkeypatch.setattr(training, "train", never)
    monkeypatch.setattr(ablations, "transfer", never)
    (tmp_path / "ablations.svg").unlink()
    ablations.main(arguments)
    assert (tmp_path / "ablations.svg").read_bytes() == picture
    for other in (["--updates", "2"], ["--trials", "3"]):
        with pytest.raises(SystemExit):
            ablations.main([*arguments, *other])
        assert "other settings" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        ablations.main(["--seeds", "1", "-o", str(tmp_path)])
    assert "at least 2" in capsys.readouterr().err
