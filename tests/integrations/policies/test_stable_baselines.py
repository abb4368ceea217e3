"""Policies of Stable-Baselines3 act as its own `predict`, described or of our environments.

Files and predictions are its own (`stable_baselines/make.py`).
"""

import base64
import io
import json
import pickle
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_pickled import NAMES, evil_pickles

from maidenflight import budget
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import transfer
from maidenflight.flying.foreign_policy import foreign_policy
from maidenflight.flying.pilots import ForeignPolicy
from maidenflight.integrations.policies.stable_baselines import environment_of, read_model
from maidenflight.simulator.controllers.interface import NOTE
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.look_ahead import LookAhead
from numpy_drone import NumpyDrone

FOLDER = Path(__file__).parent / "stable_baselines"
PREDICTIONS: dict[str, Any] = json.loads((FOLDER / "predictions.json").read_text())


@pytest.mark.parametrize("name", PREDICTIONS)
def test_it_acts_as_it_predicts(name: str) -> None:
    scaling = FOLDER / "vecnormalize.pkl" if name == "scaled" else None
    model = read_model(FOLDER / f"{name}.zip", scaling)
    for seen, action in zip(*PREDICTIONS[name].values(), strict=True):
        np.testing.assert_allclose(model.act(np.array(seen)), action, atol=2e-6)
    with pytest.raises(ValueError, match="it takes"):
        model.act(np.zeros(3))


@pytest.mark.slow
def test_nothing_of_its_package_or_of_pytorch_is_imported() -> None:
    code = (
        "import sys; from maidenflight.integrations.policies import stable_baselines as one\n"
        f"one.read_model({str(FOLDER / 'ppo.zip')!r})\n"
        "print({'torch', 'stable_baselines3', 'gymnasium'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def copied(name: str, folder: Path) -> Path:
    return Path(shutil.copy(FOLDER / f"{name}.zip", folder))


def test_one_of_our_environments_flies(tmp_path: Path) -> None:
    policy = foreign_policy(copied("ppo", tmp_path))
    assert isinstance(policy, ForeignPolicy)
    assert (policy.name, policy.rate, policy.command_rate) == ("ppo", 100, 100)
    flown = transfer(policy, NumpyDrone(), 1, duration=0.1, task=tasks.hover())
    assert np.isfinite(flown.flights[0].command).all()
    shutil.copy(FOLDER / "vecnormalize.pkl", tmp_path)
    scaled = foreign_policy(copied("scaled", tmp_path))
    assert scaled is not None
    assert scaled.name == "scaled+vecnormalize"
    with pytest.raises(InputError, match="of observations of"):
        foreign_policy(tmp_path / "ppo.zip")


def test_its_environment_is_what_it_noted() -> None:
    path = FOLDER / "scaled.zip"
    rate, spec = environment_of(path, read_model(path))
    assert rate == 100
    assert spec == PolicySpec.from_dict({"history": 2, "look_ahead": {"points": 2, "spacing": 0.3}})
    for name, reason in (("attitude_rate", "attitude_rate"), ("elsewhere", "trained in an")):
        path = FOLDER / f"{name}.zip"
        with pytest.raises(InputError, match=reason):
            environment_of(path, read_model(path))


def rebuilt(source: Path, target: Path, change: Callable[[dict[str, bytes]], None]) -> Path:
    """A copy of a zip file whose entries are changed."""
    with zipfile.ZipFile(source) as file:
        entries = {name: file.read(name) for name in file.namelist()}
    change(entries)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in entries.items():
            file.writestr(name, content)
    return target


def with_pickle(entry: str, raw: bytes) -> Callable[[dict[str, bytes]], None]:
    """A change that puts a pickle in the place of an object of `data`, or of the tensors."""

    def change(entries: dict[str, bytes]) -> None:
        if entry == "policy.pth":
            inner = io.BytesIO()
            with zipfile.ZipFile(inner, "w") as file:
                file.writestr("archive/data.pkl", raw)
            entries[entry] = inner.getvalue()
            return
        data = json.loads(entries["data"])
        data[entry] = {":type:": "x", ":serialized:": base64.b64encode(raw).decode()}
        entries["data"] = json.dumps(data).encode()

    return change


PLACES = ("observation_space", "action_space", "policy_kwargs", "policy_class", "policy.pth")
UNREAD = ("lr_schedule", "clip_range", "rollout_buffer_class", "ep_info_buffer")


@pytest.mark.parametrize("place", [*PLACES, *UNREAD, "vecnormalize.pkl"])
@pytest.mark.parametrize("name", NAMES)
def test_no_file_runs_code_wherever_it_lies(name: str, place: str, tmp_path: Path) -> None:
    evil = evil_pickles(tmp_path / "touched")[name]
    if place == "vecnormalize.pkl":
        path = copied("ppo", tmp_path)
        (tmp_path / place).write_bytes(evil)
    else:
        path = rebuilt(FOLDER / "ppo.zip", tmp_path / "evil.zip", with_pickle(place, evil))
    if place in UNREAD:
        assert foreign_policy(path) is not None
    else:
        with pytest.raises(
            InputError, match=r"evil\.zip: not a policy|vecnormalize\.pkl: not what"
        ):
            foreign_policy(path)
    assert not (tmp_path / "touched").exists()


def test_evil_state_in_a_space_is_a_state_that_is_not_looked_at(tmp_path: Path) -> None:
    """The space itself is sound, beside an attribute that would run code as it is read."""
    evil = evil_pickles(tmp_path / "touched")["REDUCE"]

    def change(entries: dict[str, bytes]) -> None:
        data = json.loads(entries["data"])
        space = base64.b64decode(data["observation_space"][":serialized:"])
        assert space.endswith(b"ub.")
        raw = space[:-3] + b"Vmore\n" + evil[:-1] + b"ub."
        data["observation_space"][":serialized:"] = base64.b64encode(raw).decode()
        entries["data"] = json.dumps(data).encode()

    path = rebuilt(FOLDER / "ppo.zip", tmp_path / "evil.zip", change)
    assert foreign_policy(path) is not None
    assert not (tmp_path / "touched").exists()


def test_what_has_code_of_its_own_is_refused_by_name(tmp_path: Path) -> None:
    class Own:
        pass

    for place, raw in {
        "policy_class": b"cmine\nPolicy\n.",
        "policy_kwargs": pickle.dumps({"activation_fn": 3}),
        "observation_space": b"cgymnasium.spaces.dict\nDict\n)\x81.",
    }.items():
        path = rebuilt(FOLDER / "ppo.zip", tmp_path / "own.zip", with_pickle(place, raw))
        with pytest.raises(InputError, match=r"mine\.Policy|hidden layers of 3|spaces\.dict\.Dict"):
            read_model(path)


@pytest.mark.parametrize("name", ["data", "policy.pth"])
def test_damage_is_refused(name: str, tmp_path: Path) -> None:
    def cut(entries: dict[str, bytes]) -> None:
        entries[name] = entries[name][:-200]

    def lose(entries: dict[str, bytes]) -> None:
        del entries[name]

    for change in (cut, lose):
        with pytest.raises(InputError, match=r"x\.zip: not a policy"):
            read_model(rebuilt(FOLDER / "sac.zip", tmp_path / "x.zip", change))
    (tmp_path / "x.zip").write_bytes((FOLDER / "sac.zip").read_bytes()[:3000])
    for path in (tmp_path / "x.zip", tmp_path / "none.zip"):
        with pytest.raises(InputError, match=path.name):
            foreign_policy(path)


def test_layers_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    def change(entries: dict[str, bytes]) -> None:
        data = json.loads(entries["data"])
        with zipfile.ZipFile(FOLDER / "elsewhere.zip") as file:
            other = json.loads(file.read("data"))
        data["observation_space"] = other["observation_space"]
        entries["data"] = json.dumps(data).encode()

    with pytest.raises(InputError, match="for 18 inputs"):
        read_model(rebuilt(FOLDER / "ppo.zip", tmp_path / "x.zip", change))


def test_tensors_beyond_their_numbers_are_refused(tmp_path: Path) -> None:
    def change(entries: dict[str, bytes]) -> None:
        path = tmp_path / "policy.pth"
        path.write_bytes(entries["policy.pth"])

        def shorten(inner: dict[str, bytes]) -> None:
            name = next(one for one in inner if one.endswith("data/1"))
            inner[name] = inner[name][:-8]

        entries["policy.pth"] = rebuilt(path, tmp_path / "short.pth", shorten).read_bytes()

    with pytest.raises(InputError, match="more numbers than are there"):
        read_model(rebuilt(FOLDER / "ppo.zip", tmp_path / "x.zip", change))
    assert budget.NETWORK.limits["numbers"] < 1e8


def test_our_environments_say_what_an_observation_is() -> None:
    gym = pytest.importorskip(
        "maidenflight.integrations.gym.single", reason="needs pip install '.[gym]'"
    )
    spec = PolicySpec(history=1, look_ahead=LookAhead(2, 0.3))
    environment = gym.QuadrotorEnv(control="attitude", spec=spec)
    assert getattr(environment.observation_space, NOTE) == {
        "control": "attitude",
        "rate": 25,
        "history": 1,
        "look_ahead": {"points": 2, "spacing": 0.3},
    }
    assert environment.action_space.shape == (4,)
