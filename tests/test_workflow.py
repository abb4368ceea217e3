"""What goes from file to file along the line."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import pytest

from maidenflight import policy, workflow
from maidenflight.identification.drone_file import DroneFile, Search, Source
from maidenflight.parameters import crazyflie
from maidenflight.training.evaluation import Evaluation
from maidenflight.training.train import Progress

SMALL = policy.untrained(jax.random.key(0), (8, 8))


@pytest.mark.parametrize(
    ("settings", "counts"),
    [
        ({"full": 65535.0}, "65535"),
        ({}, "60000"),
        ({"full": "all"}, "60000"),
        ({"full": 1e9}, "60000"),
    ],
    ids=["told", "not told", "no number", "too many"],
)
def test_what_a_command_of_one_is_reaches_the_exported_code(
    settings: dict[str, Any], counts: str, tmp_path: Path
) -> None:
    policy.write(tmp_path / "policy_1.json", SMALL, {"settings": settings})
    workflow.export(tmp_path / "policy_1.json", tmp_path / "c", 0)
    assert f"u = 1 is {counts} of" in " ".join(
        (tmp_path / "c" / "policy.h").read_text().replace("\n *", " ").split()
    )
    workflow.export(tmp_path / "policy_1.json", tmp_path / "app", 0, "crazyflie")
    assert (
        f"static float full = {counts}.0f;"
        in (tmp_path / "app" / "src" / "maidenflight.c").read_text()
    )


def test_policies_remember_what_a_command_of_one_was_in_the_logs_of_their_drone(
    tmp_path: Path, monkeypatch: Any
) -> None:
    source = Source(3, 90.0, False, "sampled", 65535.0)
    search = Search("likelihood", -15.0, 80, 3)
    DroneFile(crazyflie(), source=source, search=search).write(tmp_path / "drone.toml")

    def at_once(*given: Any) -> tuple[policy.Policy]:
        (tmp_path / "training.npz").touch()
        given[5](Progress(1, 1, Evaluation(*jnp.zeros((3, 1)))))
        return (SMALL,)

    monkeypatch.setattr("maidenflight.workflow.training.train", at_once)
    workflow.train_for(tmp_path / "drone.toml", 0, tmp_path, 1, workflow.SETTINGS["pwm"], 0.1)
    assert policy.record(tmp_path / "policy_1.json")["settings"]["full"] == 65535.0
