"""What goes from file to file along the line."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

import maidenflight as mf
from maidenflight import policy, workflow
from maidenflight.identification.drone_file import DroneFile, Search, Source
from maidenflight.parameters import crazyflie
from maidenflight.policy import Policy
from maidenflight.simulator.control import Controller
from maidenflight.training.evaluation import Evaluation
from maidenflight.training.train import Progress


def test_what_a_command_of_one_is_goes_from_the_drone_s_logs_to_the_exported_code(
    tmp_path: Path, monkeypatch: Any
) -> None:
    """The README's `export_c` of a policy trained for an identified drone, without further words,
    and the app of its file."""
    source = Source(3, 90.0, False, "subsampled", 65535.0)
    search = Search("likelihood", -15.0, 80, 3)
    DroneFile(crazyflie(), source=source, search=search).write(tmp_path / "drone.toml")

    def untrained(
        task: Any, controller: Controller, box: Any, keys: Any, settings: Any, note: Any, *_: Any
    ) -> tuple[Policy]:
        note(Progress(1, 1, Evaluation(*jnp.zeros((3, 1)))))
        (tmp_path / "training.npz").touch()
        return (policy.untrained(jax.random.key(0), (8, 8), interface=controller.interface),)

    monkeypatch.setattr("maidenflight.workflow.training.train", untrained)
    (made,) = workflow.train_for(
        tmp_path / "drone.toml", 0, tmp_path, 1, workflow.SETTINGS["pwm"], 0.1
    )
    header, _ = mf.export_c(made, tmp_path / "c")
    assert "65535 of the firmware's 65535 counts" in " ".join(
        header.read_text().replace("\n *", " ").split()
    )
    workflow.export(tmp_path / "policy_1.json", tmp_path / "app", 0, "crazyflie")
    app = (tmp_path / "app" / "src" / "maidenflight.c").read_text()
    assert "static float full = 65535.0f;" in app
