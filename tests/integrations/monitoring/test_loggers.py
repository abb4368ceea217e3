"""Scoreboards hold each score once, whatever happened before, and say what is missing before
training begins."""

import errno
import json
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from event_files import scalars
from maidenflight import events, policy_file
from maidenflight.errors import InputError, WriteError
from maidenflight.integrations.monitoring.tensorboard import tensorboard
from maidenflight.integrations.monitoring.wandb import wandb
from maidenflight.policy import untrained_policy
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.training import loggers
from maidenflight.training.evaluation import Evaluation
from maidenflight.training.train import Progress

SIZES = dict(zip(Evaluation._fields, (1.0, 0.5, 0.25, 4.0), strict=True))


def heard(number: int) -> Progress:
    """The score after so many updates of two policies."""
    return Progress(
        number,
        1000 * number,
        Evaluation(*(jnp.array([size * number, -size * number]) for size in SIZES.values())),
    )


def test_tensorboard_holds_a_run_a_policy_and_each_score_once_after_a_resume(
    tmp_path: Path,
) -> None:
    pytest.importorskip("tensorboardX")
    for last in (1, 2):
        with loggers.opened(
            ["tensorboard", "tensorboard"], tmp_path, 2, {"task": "circle"}
        ) as show:
            for number in range(1, last + 1):
                show(heard(number))
    runs = tmp_path / "tensorboard"
    assert sorted(path.name for path in runs.iterdir()) == ["policy_1", "policy_2"]
    for sign, name in ((1.0, "policy_1"), (-1.0, "policy_2")):
        assert scalars(runs / name) == [
            (tag, 1000 * number, sign * size * number)
            for number in (1, 2)
            for tag, size in SIZES.items()
        ]


def test_a_program_that_listens_hears_scores_and_the_first_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(3,)))
    best = jax.tree.map(lambda leaf: jnp.stack([leaf, 0 * leaf]), policy)
    with loggers.opened([], tmp_path, 2, {"task": "hover"}) as show:
        show(heard(1))
        assert capsys.readouterr().out == ""
        monkeypatch.setenv(events.VARIABLE, "1")
        show(heard(1))
        show(heard(2)._replace(best=best))
    first, second = map(json.loads, capsys.readouterr().out.splitlines())
    assert (first["update"], first["steps"], first["policy"]) == (1, 1000, "")
    assert [one["episode_return"] for one in second["scores"]] == [2.0, -2.0]
    read = policy_file.from_json(second["policy"])
    assert read.record["settings"]["task"] == "hover"
    for own, other in zip(jax.tree.leaves(read.policy), jax.tree.leaves(policy), strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-6)


def test_scores_can_be_seen_while_training_goes_on(tmp_path: Path) -> None:
    pytest.importorskip("tensorboardX")
    with tensorboard(tmp_path, 1, {}) as show:
        show(heard(1))
        assert len(scalars(tmp_path / "tensorboard" / "policy_1")) == len(SIZES)


def test_an_earlier_log_stays_until_there_is_a_score(tmp_path: Path) -> None:
    pytest.importorskip("tensorboardX")
    with tensorboard(tmp_path, 2, {}) as show:
        show(heard(1))
    with pytest.raises(InputError, match="refused"), tensorboard(tmp_path, 1, {}):
        raise InputError("refused")
    assert len(scalars(tmp_path / "tensorboard" / "policy_2")) == len(SIZES)
    with tensorboard(tmp_path, 1, {}) as show:
        show(heard(1))
    assert scalars(tmp_path / "tensorboard" / "policy_2") == []


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    pytest.importorskip("tensorboardX")
    (tmp_path / "tensorboard").write_text("in the way")
    with (
        tensorboard(tmp_path, 1, {}) as show,
        pytest.raises(InputError, match="cannot be written"),
    ):
        show(heard(1))


def test_a_disk_that_fills_up_is_said_and_nothing_more_comes_of_it(
    tmp_path: Path, monkeypatch: Any
) -> None:
    pytest.importorskip("tensorboardX")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    def two_scores() -> None:
        with tensorboard(tmp_path, 1, {}) as show:
            show(heard(1))
            monkeypatch.setattr(os, "fsync", full)
            show(heard(2))

    with pytest.raises(WriteError, match="No space left on device"):
        two_scores()


class Wandb(ModuleType):
    """Records what is asked of Weights & Biases."""

    Error = type("Error", (Exception,), {})

    def __init__(self) -> None:
        super().__init__("wandb")
        self.runs: list[Any] = []
        self.refuses = False

    def Settings(self, **settings: Any) -> dict[str, Any]:
        return settings

    def init(self, **arguments: Any) -> "Run":
        if self.refuses and self.runs:
            raise self.Error("No API key configured.")
        self.runs.append(Run(arguments))
        return self.runs[-1]


class Run:
    def __init__(self, arguments: dict[str, Any]) -> None:
        self.arguments, self.logged, self.ended = arguments, [], None

    def log(self, values: dict[str, float], step: int) -> None:
        self.logged.append((step, values))

    def finish(self, exit_code: int = 0) -> None:
        self.ended = "failed" if exit_code else "finished"


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Wandb:
    made = Wandb()
    monkeypatch.setitem(sys.modules, "wandb", made)
    for name in ("PROJECT", "RUN_GROUP", "DIR"):
        monkeypatch.delenv(f"WANDB_{name}", raising=False)
    return made


def test_weights_and_biases_gets_a_run_a_policy(fake: Wandb, tmp_path: Path) -> None:
    with loggers.opened(["wandb"], tmp_path / "hover", 2, {"task": "hover"}) as show:
        show(heard(1))
        show(heard(2))
        assert [run.ended for run in fake.runs] == [None, None]
    first, second = fake.runs
    assert second.logged[0] == (1000, {name: -size for name, size in SIZES.items()})
    assert [step for step, _ in first.logged] == [1000, 2000]
    assert [run.ended for run in fake.runs] == ["finished", "finished"]
    told = {
        "project": "maidenflight",
        "group": "hover",
        "dir": str(tmp_path / "hover"),
        "config": {"task": "hover"},
        "name": "policy_2",
    }
    assert {name: second.arguments[name] for name in told} == told
    assert (tmp_path / "hover").is_dir()


def test_its_environment_variables_win(
    fake: Wandb, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = {"PROJECT": "mine", "RUN_GROUP": "first", "DIR": "elsewhere"}
    for name, value in given.items():
        monkeypatch.setenv(f"WANDB_{name}", value)
    with wandb(tmp_path, 1, {}):
        pass
    assert [fake.runs[0].arguments[name] for name in ("project", "group", "dir")] == list(
        given.values()
    )


def test_runs_of_what_was_interrupted_end_as_failed(fake: Wandb, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), wandb(tmp_path, 2, {}):
        raise KeyboardInterrupt
    assert [run.ended for run in fake.runs] == ["failed", "failed"]


def test_a_run_that_cannot_be_begun_gives_one_line_and_closes_the_others(
    fake: Wandb, tmp_path: Path
) -> None:
    fake.refuses = True
    with (
        pytest.raises(InputError, match=r"No API key configured\. Or set WANDB_MODE=offline"),
        wandb(tmp_path, 2, {}),
    ):
        pass
    assert [run.ended for run in fake.runs] == ["failed"]
