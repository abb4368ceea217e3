"""What needs a package that is not installed says in a line which extra brings it."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import pytest

from maidenflight.errors import InputError
from maidenflight.experiments.drones import find_reality
from maidenflight.integrations.app.app import App
from maidenflight.integrations.exporters.onnx import export_onnx
from maidenflight.integrations.logs import blackbox, dataflash, rosbag, ulog
from maidenflight.integrations.px4_network.export import export_px4
from maidenflight.integrations.raptor.export import export_raptor
from maidenflight.policy import untrained_policy
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.studies import store
from maidenflight.studies.engine import Resources, engine
from maidenflight.training import loggers


def of_form(form: str) -> Any:
    return untrained_policy(jax.random.key(0), spec=PolicySpec(form=form))


def log_by(name: str, folder: Path) -> None:
    with loggers.opened([name], folder / "policies", 1, {}):
        pass


NEEDS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "pyulog": ("ulog", lambda folder: ulog.flights(folder / "a.ulg", "a.ulg")),
    "pymavlink.DFReader": (
        "ardupilot",
        lambda folder: dataflash.flights(folder / "a.bin", "a.bin"),
    ),
    "orangebox": ("blackbox", lambda folder: blackbox.flights(folder / "a.bbl", "a.bbl")),
    "rosbags.rosbag2": ("rosbag", lambda folder: rosbag.flights(folder / "a.mcap", "a.mcap")),
    "pybullet": ("pybullet", lambda _: find_reality("pybullet:7")),
    "crazyflow": ("crazyflow", lambda _: find_reality("crazyflow:cf2x_L250")),
    "l2f": ("l2f", lambda _: find_reality("l2f:x500")),
    "mujoco": ("mujoco", lambda _: find_reality("mujoco:x500")),
    "tensorboardX": ("tensorboard", lambda folder: log_by("tensorboard", folder)),
    "wandb": ("wandb", lambda folder: log_by("wandb", folder)),
    "ray": ("ray", lambda folder: engine("ray", Resources(logs=str(folder)))),
    "submitit": ("slurm", lambda folder: engine("slurm", Resources(logs=str(folder)))),
    "fsspec": ("remote", lambda _: store.opened("memory://study")),
    "onnx": ("onnx", lambda folder: export_onnx(untrained_policy(jax.random.key(0)), folder)),
    "starlette": ("app", lambda folder: App(folder=folder).run()),
    "h5py": ("raptor", lambda folder: export_raptor(of_form("raptor"), folder)),
    "tflite": ("px4", lambda folder: export_px4(of_form("px4"), folder)),
}
"""By package: its extra, and what needs it."""


@pytest.mark.parametrize("package", NEEDS)
def test_a_lacking_package_is_named_with_its_extra_and_nothing_is_written(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    extra, need = NEEDS[package]
    monkeypatch.setitem(sys.modules, package, None)
    name = package.partition(".")[0]
    with pytest.raises(
        InputError, match=rf"^{name} is not installed.*pip install -e '.\[{extra}\]'"
    ):
        need(tmp_path)
    assert list(tmp_path.iterdir()) == []
