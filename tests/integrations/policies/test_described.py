"""A network in ONNX flies as its TOML file says: one of ours, exported, as itself."""

import dataclasses
import re
from pathlib import Path

import jax
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.experiments.transfer import transfer
from maidenflight.flying.foreign_policy import foreign_policy
from maidenflight.flying.pilots import ForeignPolicy
from maidenflight.integrations.exporters.onnx import export_onnx
from maidenflight.integrations.policies.described import INPUTS, DescribedPolicy, described
from maidenflight.policy import untrained_policy
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.look_ahead import LookAhead
from numpy_drone import NumpyDrone

PAGE = Path(__file__).parents[3] / "docs" / "evaluation.md"
(OURS,) = re.findall(r"^```toml\n(.*?)^```", PAGE.read_text(), re.M | re.S)
OURS = OURS.replace("onnx_policy/", "")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    pytest.importorskip("onnxruntime")
    export_onnx(untrained_policy(jax.random.key(3)), tmp_path)
    (tmp_path / "ours.toml").write_text(OURS)
    return tmp_path / "ours.toml"


def test_our_policy_flies_as_itself(file: Path) -> None:
    theirs = foreign_policy(file)
    assert isinstance(theirs, DescribedPolicy)
    assert isinstance(theirs, ForeignPolicy)
    assert theirs.name == "ours"
    ours, flown = (
        transfer(one, NumpyDrone(), 1, duration=0.4).flights[0]
        for one in (untrained_policy(jax.random.key(3)), theirs)
    )
    np.testing.assert_allclose(flown.command, ours.command, atol=1e-5)
    np.testing.assert_allclose(flown.position, ours.position, atol=1e-5)


def test_our_policy_that_looks_ahead_flies_as_itself(file: Path) -> None:
    ahead = untrained_policy(jax.random.key(3), spec=PolicySpec(look_ahead=LookAhead(2, 0.4)))
    strong = ahead.observation_std.at[40:].mul(0.1)
    ahead = dataclasses.replace(ahead, observation_std=strong)
    export_onnx(ahead, file.parent)
    file.write_text(OURS + "look_ahead = {points = 2, spacing = 0.4}\n")
    ours, flown = (
        transfer(one, NumpyDrone(), 1, duration=0.2).flights[0] for one in (ahead, described(file))
    )
    np.testing.assert_allclose(flown.command, ours.command, atol=1e-5)
    np.testing.assert_allclose(flown.position, ours.position, atol=1e-5)


def test_rotor_speed_is_squared_motors_are_reordered_and_numbers_are_scaled(file: Path) -> None:
    said = OURS.replace('"thrust"', '"rotor_speed"')
    file.write_text(said + "motors = [4, 3, 2, 1]\n")
    policy = described(file)
    fly = policy.begin(0.5, tasks.hover())
    seen = NumpyDrone()
    seen.reset(np.array([0.0, 0.0, 1.0]), 0)
    policy._run = lambda numbers: np.array([-1.0, 0.0, 0.5, 3.0])  # type: ignore
    command = fly(seen.observe(), np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(command, [1.0, 0.75**2, 0.25, 0.0])


@pytest.mark.parametrize(
    ("before", "after", "named"),
    [
        ('"velocity"', '"speed"', "speed"),
        ("rate = 100", "rate = 90", "rate"),
        ("[-1, 1]", "[1, 0]", "range"),
        ('"thrust"', '"force"', "commands"),
        ("history = 2", "history = 3", "inputs"),
        ('output = "action"', 'output = "nothing"', "nothing"),
        ("history = 2", "histories = 2", "histories"),
        ("rate = 100", "", "rate"),
        ("rate = 100", "rate = ", "TOML"),
        ('"policy.onnx"', '"other.onnx"', "other.onnx"),
        ("history = 2", "history = 2\nstd = [1, 2]", "std"),
        ("history = 2", "history = 2\nmotors = [1, 2, 3, 3]", "motors"),
        ("[-1, 1]", '"all"', "range"),
        ("history = 2", "history = 2\nmean = []", "mean"),
        ("history = 2", "history = 2\nlook_ahead = 5", "look-ahead"),
        ("history = 2", "history = 2\nlook_ahead = {points = 5, spacing = 0.1}", "look_ahead"),
    ],
)
def test_what_makes_no_sense_is_refused(file: Path, before: str, after: str, named: str) -> None:
    file.write_text(OURS.replace(before, after))
    with pytest.raises(InputError, match=named):
        transfer(described(file), NumpyDrone(), 1, duration=0.1)


def test_inputs_have_their_sizes() -> None:
    from maidenflight.integrations.policies.described import _EXAMPLE

    sizes = {name: len(part(_EXAMPLE)) for name, part in INPUTS.items()}
    nine = {"rotation_matrix": 9, "quaternion_xyzw": 4, "quaternion_wxyz": 4, "last_action": 4}
    assert sizes == {name: nine.get(name, 3) for name in INPUTS}
