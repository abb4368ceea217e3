"""Policies of Stable-Baselines3 act as its own `predict`, of our environments or by a class."""

import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.experiments.transfer import transfer
from maidenflight.flying.foreign_policy import foreign_policy
from maidenflight.flying.pilots import ForeignPolicy
from maidenflight.integrations.policies.environment_policy import EnvironmentPolicy
from maidenflight.simulator.controllers.interface import NOTE
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec, observe, points_at, remember
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.look_ahead import LookAhead
from numpy_drone import NumpyDrone

EXAMPLES = Path(__file__).parents[3] / "examples"
AHEAD = PolicySpec(history=3, look_ahead=LookAhead(2, 0.3))


@pytest.fixture(scope="module")
def learners() -> Any:
    reason = "needs pip install stable-baselines3 torch==2.13.0"
    pytest.importorskip("gymnasium", reason=reason)
    return pytest.importorskip("stable_baselines3", reason=reason)


def trained(learners: Any, name: str, folder: Path, **settings: Any) -> Any:
    """A policy as it begins, of an environment of ours, saved as `model.zip`."""
    import gymnasium

    environment = gymnasium.make("maidenflight.integrations.gym:maidenflight/Circle-v0", **settings)
    memory = {"buffer_size": 10} if name in ("SAC", "TD3") else {"n_steps": 64}
    layers = {"net_arch": [16], "log_std_init": -1.0} if name in ("PPO", "A2C") else {}
    size = {"policy_kwargs": layers or {"net_arch": [16]}}
    model = getattr(learners, name)(
        "MlpPolicy", environment, seed=1, device="cpu", **memory, **size
    )
    model.save(folder / "model")
    return model


def instants(count: int) -> list[Measurement]:
    drawn = np.random.default_rng(0).normal(0.0, 0.3, (count, 13))
    drawn[:, 6:10] /= np.linalg.norm(drawn[:, 6:10], axis=1, keepdims=True)
    parts = (drawn[:, :3], drawn[:, 3:6], drawn[:, 6:10], drawn[:, 10:])
    return [Measurement(*(jnp.asarray(part[row]) for part in parts)) for row in range(count)]


def agrees(policy: ForeignPolicy, act: Any, spec: PolicySpec) -> None:
    """The policy commands what `act` gives of observations that our simulator makes."""
    hover, task = 0.55, tasks.circle()
    fly, seen = policy.begin(hover, task), None
    action = np.full(4, 2 * hover - 1)
    for number, measurement in enumerate(instants(5)):
        setpoint = np.array([0.1, -0.2, 1.0])
        instant = observe(measurement, jnp.asarray(setpoint), jnp.asarray(action))
        past = jnp.stack([instant] * spec.history) if seen is None else remember(seen, instant)
        seen = past
        points = np.asarray(points_at(spec, task.reference, number / 100))
        near = (points - np.asarray(measurement.position)).ravel()
        action = act(np.concatenate([np.ravel(past), near]).astype(np.float32))
        made = fly(measurement, setpoint)
        np.testing.assert_allclose(made, (np.clip(action, -1, 1) + 1) / 2, atol=1e-6)


@pytest.mark.parametrize("name", ["PPO", "A2C", "SAC", "TD3"])
def test_it_acts_as_it_predicts(learners: Any, name: str, tmp_path: Path) -> None:
    model = trained(learners, name, tmp_path)
    policy = foreign_policy(tmp_path / "model.zip")
    assert isinstance(policy, EnvironmentPolicy)
    assert isinstance(policy, ForeignPolicy)
    assert (policy.name, policy.rate, policy.command_rate) == ("model", 100, 100)
    agrees(policy, lambda seen: model.predict(seen, deterministic=True)[0], PolicySpec())


def test_scaled_with_more_history_and_look_ahead(learners: Any, tmp_path: Path) -> None:
    from stable_baselines3.common.vec_env import (  # pyright: ignore[reportMissingImports]
        DummyVecEnv,
        VecNormalize,
    )

    model = trained(learners, "PPO", tmp_path, spec=AHEAD)
    scaling = VecNormalize(DummyVecEnv([lambda: model.get_env().envs[0]]))
    generator = np.random.default_rng(0)
    scaling.obs_rms.mean = generator.normal(0.0, 0.2, 66)
    scaling.obs_rms.var = generator.uniform(0.1, 2.0, 66)
    scaling.save(str(tmp_path / "vecnormalize.pkl"))
    policy = foreign_policy(tmp_path / "model.zip")
    assert policy is not None
    assert policy.name == "model+vecnormalize"

    def act(seen: np.ndarray) -> np.ndarray:
        return model.predict(scaling.normalize_obs(seen), deterministic=True)[0]

    agrees(policy, act, AHEAD)


def test_one_of_another_environment_flies_by_the_class_of_the_example(
    learners: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import gymnasium

    class Theirs(gymnasium.Env):  # type: ignore[type-arg]
        observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (18,), np.float32)
        action_space = gymnasium.spaces.Box(0.0, 1.0, (4,), np.float32)

    model = learners.PPO("MlpPolicy", Theirs(), device="cpu", n_steps=64, seed=0)
    model.save(tmp_path / "theirs")
    with pytest.raises(InputError, match="MODULE:NAME"):
        foreign_policy(tmp_path / "theirs.zip")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [str(EXAMPLES), *sys.path])
    policy = foreign_policy("own_sb3_policy:Theirs")
    assert policy is not None
    assert policy.rate == 50
    level = Measurement(*map(jnp.asarray, ([0, 0, 1.1], [0, 0, 0], [0, 0, 0, 1.0], [0, 0, 0])))
    made = policy.begin(0.5, tasks.hover(1.0))(level, np.array([0.0, 0.0, 1.0]))
    seen = np.array([0, 0, 0.1, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0], np.float32)
    wanted = np.clip(model.predict(seen, deterministic=True)[0], 0, 1) ** 2
    np.testing.assert_allclose(made, wanted, atol=1e-6)
    flown = transfer(policy, NumpyDrone(), 1, duration=0.1, task=tasks.hover())
    assert np.isfinite(flown.flights[0].command).all()


def test_policies_that_do_not_command_motors_are_refused(learners: Any, tmp_path: Path) -> None:
    trained(learners, "PPO", tmp_path, control="attitude_rate")
    with pytest.raises(InputError, match="attitude_rate"):
        foreign_policy(tmp_path / "model.zip")


def test_what_is_no_policy_is_refused(learners: Any, tmp_path: Path) -> None:
    (tmp_path / "model.zip").write_text("no zip")
    with pytest.raises(InputError, match=r"model\.zip"):
        foreign_policy(tmp_path / "model.zip")
    with pytest.raises(InputError, match=r"none\.zip"):
        foreign_policy(tmp_path / "none.zip")


def test_without_its_package_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(InputError, match="sb3"):
        foreign_policy("model.zip")


def test_our_environments_say_what_an_observation_is() -> None:
    gym = pytest.importorskip(
        "maidenflight.integrations.gym.single", reason="needs pip install '.[gym]'"
    )
    spec = PolicySpec(history=1, look_ahead=AHEAD.look_ahead)
    environment = gym.QuadrotorEnv(control="attitude", spec=spec)
    assert getattr(environment.observation_space, NOTE) == {
        "control": "attitude",
        "rate": 25,
        "history": 1,
        "look_ahead": {"points": 2, "spacing": 0.3},
    }
    assert environment.action_space.shape == (4,)
