"""The examples run, with less work."""

import runpy
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import maidenflight as mf
from maidenflight.errors import InputError
from maidenflight.flying.foreign_policy import foreign_policy
from maidenflight.flying.pilots import ForeignPolicy
from maidenflight.policy_file import write_policy
from maidenflight.verbs.train import Train
from maidenflight.verbs.transfer import Transfer
from numpy_drone import NumpyDrone
from quick import make_training_quick, replace_training, traced_training

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.slow
def test_stable_baselines3_learns_on_the_environments_as_they_are(tmp_path):
    """A tenth of the example's steps keeps the drone up for longer than none."""
    pytest.importorskip(
        "stable_baselines3", reason="needs pip install stable-baselines3 torch==2.13.0"
    )
    command = [sys.executable, str(EXAMPLES / "train_with_stable_baselines3.py")]
    command += ["--steps", "245760", "--evaluations", "1", "--episodes", "32"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    header, first, *_, last = (tmp_path / "circle.csv").read_text().splitlines()
    before, after = (
        dict(zip(header.split(","), row.split(","), strict=True)) for row in (first, last)
    )
    assert float(after["duration"]) > 1.4 * float(before["duration"])
    assert (tmp_path / "circle.zip").exists()


@pytest.fixture
def in_examples(monkeypatch):
    """The folder of the examples as a user's working folder."""
    monkeypatch.chdir(EXAMPLES)
    monkeypatch.setattr("sys.path", list(sys.path))
    make_training_quick(monkeypatch)


def test_examples_of_extending_are_short():
    files = sorted(EXAMPLES.glob("own_*.py"))
    assert len(files) == 9
    lines = {file.name: sum(map(bool, file.read_text().split("\n"))) for file in files}
    assert max(lines.values()) <= 40, lines


@pytest.mark.parametrize(
    "traced",
    [pytest.param(True, marks=pytest.mark.slow), pytest.param(False, marks=pytest.mark.night)],
)
def test_ones_own_task_controller_and_drones_train_and_fly_by_their_names(
    traced, in_examples, tmp_path, monkeypatch
):
    if traced:
        replace_training(monkeypatch, traced_training)
    train = Train(
        drone="crazyflie",
        task="own_task:helix",
        control="own_controller:torques",
        randomize="own_distribution:weak_motor",
        policies=1,
        hidden=(4,),
    )
    (policy,) = train.run(tmp_path / "policies").value
    assert policy.interface.name == "torques"
    transfer = Transfer(
        policies=(str(tmp_path / "policies"),),
        control="own_controller:torques",
        task="own_task:helix",
        reality=("virtual:7",),
        against=(),
        trials=1,
        duration=1.0,
    )
    rows = transfer.run(tmp_path / "transfer").value.table
    assert rows["duration"].max() <= 1.0


def test_ones_own_network_is_in_no_file_and_no_export(in_examples, tmp_path):
    tanh = runpy.run_path("own_network.py")["TanhPolicy"]
    policy = tanh(**vars(mf.untrained_policy(jax.random.key(0))))
    assert policy(np.zeros(40, np.float32)).shape == (4,)
    for attempt in (
        lambda: write_policy(tmp_path / "policy.json", policy),
        lambda: mf.export(policy, tmp_path / "code"),
    ):
        with pytest.raises(InputError, match="network of its own"):
            attempt()
    assert not list(tmp_path.iterdir())


def test_ones_own_network_in_onnx_flies_as_the_policy_that_it_was_exported_from(
    in_examples, tmp_path, monkeypatch
):
    for package in ("onnx", "onnxruntime"):
        pytest.importorskip(package)
    policy = mf.untrained_policy(jax.random.key(3))
    mf.export(policy, tmp_path / "onnx_policy", "onnx")
    monkeypatch.syspath_prepend(EXAMPLES)
    monkeypatch.chdir(tmp_path)
    mine = foreign_policy("own_onnx_policy:Mine")
    assert isinstance(mine, ForeignPolicy)
    ours, theirs = (
        mf.transfer([one], [NumpyDrone()], 1, duration=0.4).flights[0] for one in (policy, mine)
    )
    np.testing.assert_allclose(theirs.command, ours.command, atol=1e-5)
    np.testing.assert_allclose(theirs.position, ours.position, atol=1e-5)


@pytest.mark.parametrize("name", ["own_reality:Mine", "own_network:mf", "own_task:nothing"])
def test_what_is_no_policy_is_refused(in_examples, name):
    with pytest.raises(InputError, match=name):
        foreign_policy(name)


@pytest.mark.slow
def test_ones_own_learner_comes_closer(in_examples):
    learn = runpy.run_path("own_learner.py")["learn"]
    learn.__globals__["DRONES"] = 16
    with jax.numpy_dtype_promotion("standard"):  # optax's Adam takes powers of whole numbers
        _, distances = learn(jax.random.key(0), updates=60)
    assert np.mean(distances[-5:]) < 0.5 * distances[0]


@pytest.mark.slow
def test_ones_own_optimiser_finds_the_lag_and_ones_own_reality_records(in_examples):
    truth = mf.virtual_drone(7)
    flights = mf.record(truth, jax.random.key(0), flights=1, duration=6.0)
    best = runpy.run_path("own_optimiser.py")["fit"](flights, truth.parameters, evaluations=40)
    assert best.motor_time_constant == pytest.approx(truth.parameters.motor_time_constant, rel=0.15)
    reality = runpy.run_path("own_reality.py")["Mine"]()
    (flight,) = mf.record(reality, jax.random.key(0), flights=1, duration=2.0)
    assert abs(flight.position[-1, 2] - 1.0) < 0.1
