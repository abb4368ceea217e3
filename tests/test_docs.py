"""Every snippet in the README and the docs runs: the real functions, with less work each."""

import importlib.util
import re
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import Any

import click
import jax
import numpy as np
import pytest

import maidenflight as mf
from maidenflight import cli, parameters, policy
from maidenflight.flights import log

ROOT = Path(__file__).parent.parent
QUICK = mf.AnalyticGradient(updates=2, evaluations=1, drones=4, horizon=4, episodes=4)
LESS_WORK = {
    "record": ["--flights", "2", "--duration", "4"],
    "identify": ["--trials", "1", "--evaluations", "15", "--over", "thrust_to_weight,latency"],
    "train": ["--policies", "2", "--updates", "2"],
    "transfer": ["--trials", "1", "--duration", "0.5"],
    "predict": ["--trials", "2", "--duration", "0.5"],
}


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", (ROOT / page).read_text(), re.M | re.S)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)


def test_the_python_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, flight in enumerate(mf.record(mf.virtual_drone(7), jax.random.key(0), flights=2, duration=4.0)):
        log.write(f"run/recorded/flight_{number}.csv", flight)
    monkeypatch.setattr(mf, "identify", partial(mf.identify, over=["thrust_to_weight", "latency"], evaluations=15, trials=1), raising=False)
    monkeypatch.setattr(mf, "train", partial(mf.train, settings=QUICK), raising=False)
    monkeypatch.setattr(mf, "transfer", partial(mf.transfer, duration=0.5), raising=False)
    (snippet,) = blocks("README.md", "python")
    exec(compile(snippet, "README.md", "exec"), {})
    assert (tmp_path / "firmware/policy.c").exists()
    assert (tmp_path / "report.html").exists()


def test_the_python_of_the_simulators_page_runs() -> None:
    pytest.importorskip("gymnasium")
    snippets = blocks("docs/simulator.md", "python")
    assert len(snippets) >= 7
    names: dict[str, Any] = {}
    for snippet in snippets:
        if "bullet" in snippet and importlib.util.find_spec("pybullet") is None:
            continue
        exec(compile(snippet, "docs/simulator.md", "exec"), names)
    assert names["picture"].shape == (480, 640, 3)


def test_the_commands_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commands = [line for block in blocks("README.md", "sh") for line in block.splitlines() if line.startswith("maidenflight ")]
    assert len(commands) >= 6
    for line in commands:
        arguments = shlex.split(line, comments=True)
        monkeypatch.setattr(sys, "argv", arguments + LESS_WORK.get(arguments[1], []))
        cli.main()
    assert (tmp_path / "report.html").exists()


def test_the_make_targets_that_the_pages_name_exist() -> None:
    makefile = (ROOT / "Makefile").read_text()
    named = {name for page in ("README.md", "CONTRIBUTING.md") for name in re.findall(r"\bmake (\w+)", (ROOT / page).read_text())}
    assert {"demo", "test"} <= named
    assert all(f"\n{name}:" in makefile for name in named)


def test_the_log_format_page_lists_every_column_of_the_format() -> None:
    page = (ROOT / "docs/flight-log.md").read_text()
    rows = " ".join(line for line in page.splitlines() if line.startswith("| `"))
    for columns in log.GROUPS.values():
        for column in columns:
            assert f"`{column}`" in rows or column in ("command_2", "command_3"), column


def test_pages_link_only_to_what_exists() -> None:
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
            assert (page.parent / target).exists(), (page.name, target)


def test_all_public_names_resolve() -> None:
    missing: list[Any] = [name for name in mf.__all__ if not hasattr(mf, name)]
    assert missing == []
    assert all(callable(getattr(mf, name)) for name in mf.__all__ if name != "__version__")
    with pytest.raises(AttributeError):
        _ = mf.nonsense  # type: ignore[attr-defined]
    assert np.isfinite(float(parameters.crazyflie().mass))


def test_the_python_of_the_training_page_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    small = partial(mf.AnalyticGradient, drones=4, horizon=4, evaluations=1, episodes=4)
    monkeypatch.setattr(mf, "AnalyticGradient", lambda updates: small(updates=1), raising=False)
    (snippet,) = blocks("docs/training.md", "python")
    names: dict[str, Any] = {}
    exec(compile(snippet, "docs/training.md", "exec"), names)
    assert [policy.layer_sizes for policy in names["policies"]] == [(40, 50, 50, 4)] * 3
    assert Path("training.npz").exists()


def test_the_python_of_the_transfer_page_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for path in ("policies/policy_1.json", "attitude_rate_066.json"):
        policy.write(path, policy.untrained(jax.random.key(0)))
    parameters.write("drone.toml", parameters.crazyflie(), {})
    monkeypatch.setattr(mf, "predict_flight_times", partial(mf.predict_flight_times, trials=2, duration=0.5), raising=False)
    (snippet,) = blocks("docs/transfer.md", "python")
    names: dict[str, Any] = {}
    exec(compile(snippet, "docs/transfer.md", "exec"), names)
    assert names["flown"]["policy"].to_list() == ["ours"] * 2 + ["theirs"] * 2
    assert "quantile_90" in capsys.readouterr().out


def test_the_python_of_the_identification_page_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for number, flight in enumerate(mf.record(mf.virtual_drone(7), jax.random.key(0), flights=2, duration=4.0)):
        log.write(f"run/recorded/flight_{number}.csv", flight)
    monkeypatch.setattr(mf, "identify", partial(mf.identify, over=["thrust_to_weight", "latency"], evaluations=15, trials=1), raising=False)
    (snippet,) = blocks("docs/identification.md", "python")
    names: dict[str, Any] = {}
    exec(compile(snippet, "docs/identification.md", "exec"), names)
    assert "thrust_to_weight" in capsys.readouterr().out
    assert names["paper"].kind == "replay"
    assert len(names["drones"].drones.mass) > 100


def test_the_python_and_the_commands_of_the_realities_page_run(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pybullet")
    (snippet,) = blocks("docs/realities.md", "python")
    policies = [policy.untrained(jax.random.key(0))]
    monkeypatch.setattr(mf, "transfer", partial(mf.transfer, duration=0.5), raising=False)
    names: dict[str, Any] = {"policies": policies}
    exec(compile(snippet, "docs/realities.md", "exec"), names)
    assert set(names["flown"].table["reality"]) == {"virtual-7", "worn-7"}
    policy.write("policies/policy_1.json", policies[0])
    commands = [line for line in blocks("docs/realities.md", "sh")[0].splitlines() if line.startswith("maidenflight ")]
    assert len(commands) == 2
    for line in commands:
        arguments = shlex.split(line, comments=True)
        monkeypatch.setattr(sys, "argv", arguments + LESS_WORK[arguments[1]])
        cli.main()
    assert Path("recorded/reality.toml").exists()


def test_every_command_that_a_page_shows_is_one_that_there_is() -> None:
    shown = 0
    for page in ["README.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))]:
        for line in [line for block in blocks(page, "sh") for line in block.replace("\\\n", " ").splitlines()]:
            words = shlex.split(line, comments=True)
            if words[:1] != ["maidenflight"]:
                continue
            command = cli.commands.commands[words[1]]
            command.parse_args(click.Context(command, info_name=words[1]), words[2:])
            shown += 1
    assert shown > 20


def test_the_commands_of_the_zero_shot_page_run(monkeypatch: pytest.MonkeyPatch) -> None:
    told = """
        realities = ["near:7"]
        motor_time_constant = [0.04, 0.08]
        latency = [0.0, 0.015]
        policies = 1
        trials = 2
        duration = 0.3
        [control.pwm]
        updates = 1
        drones = 2
        horizon = 2
        hidden = [8]
        evaluations = 1
        episodes = 2
    """
    for command in blocks("docs/zero-shot.md", "sh")[0].splitlines():
        words = shlex.split(command, comments=True)
        if words[0] == "maidenflight":
            settings = Path(words[words.index("--matrix") + 1])
            assert (ROOT / settings).exists()
            settings.parent.mkdir()
            settings.write_text(told)
            monkeypatch.setattr(sys, "argv", words)
            cli.main()
        else:
            assert (ROOT / words[1]).exists(), command
    assert Path("zero_shot/flights.csv").exists()


def test_the_commands_of_the_pilots_guide_are_ones_that_there_are() -> None:
    lines = [shlex.split(line, comments=True) for line in re.findall(r"^maidenflight .*", (ROOT / "docs/pilot.md").read_text(), re.M)]
    assert {words[1] for words in lines} >= {"record", "fly", "identify", "train", "predict"}
    for words in lines:
        command = cli.commands.commands[words[1]]
        command.parse_args(click.Context(command, info_name=words[1]), words[2:])
