"""`Train`: what it gives to training, checks before it, and says in its files."""

import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import pytest

import maidenflight as mf
from maidenflight import manifest, policy_file
from maidenflight.errors import InputError
from maidenflight.identification.drone_file import DroneFile, Search, Source
from maidenflight.names import CONTROLS, TASKS
from maidenflight.parameters import crazyflie
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks.look_ahead import LookAhead
from maidenflight.simulator.tasks.tasks import find_task
from maidenflight.terminal import Bar
from maidenflight.training import defaults
from maidenflight.training.evaluation import Evaluation
from maidenflight.training.final_flights import ITSELF, FinalFlight
from maidenflight.training.train import Progress
from maidenflight.verbs.export import Export
from maidenflight.verbs.train import Train

TRAINING = "maidenflight.training.train.train"
FLIGHTS = "maidenflight.training.final_flights.fly_drones"


def flights_of(*lasting: bool) -> list[FinalFlight]:
    """One of the drone itself, and as many of others."""
    kinds = ITSELF, "near", "far"
    return [
        FinalFlight(
            kind, f"{kind}:7", 20.0 if lasts else 8.1, "time limit" if lasts else "tilt", 0.01
        )
        for kind, lasts in zip(kinds, lasting, strict=True)
    ]


@pytest.fixture(autouse=True)
def no_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the place of flights: the second policy falls in one drone of three."""
    flown = [flights_of(True, True, True), flights_of(True, True, False)]
    monkeypatch.setattr(FLIGHTS, lambda _, policies, *__: flown[: len(policies)])


def no_training(
    task: Any,
    controller: Controller,
    *_: Any,
    policy: Any,
    on_progress: Any,
    **__: Any,
) -> tuple[Policy]:
    """In the place of training: a policy that knows nothing."""
    on_progress(Progress(1, 1, Evaluation(*jnp.zeros((4, 1)))))
    spec = policy if isinstance(policy, PolicySpec) else policy.spec
    return (untrained_policy(jax.random.key(0), controller.interface, spec),)


def test_what_a_command_of_one_is_goes_from_the_drone_s_logs_to_the_exported_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The README's `export_c` of a policy trained for an identified drone, without further words,
    and the app of its file."""
    source = Source(3, 90.0, False, "subsampled", 65535.0)
    search = Search("likelihood", -15.0, 80, 3)
    DroneFile(crazyflie(), source=source, search=search).write(tmp_path / "drone.toml")

    monkeypatch.setattr(TRAINING, no_training)
    train = Train(drone=str(tmp_path / "drone.toml"), policies=1, hidden=(8, 8))
    (made,) = train.run(tmp_path).value
    header, _ = mf.export(made, tmp_path / "c")
    assert "65535 of the firmware's 65535 counts" in " ".join(
        header.read_text().replace("\n *", " ").split()
    )
    Export(policy=tmp_path / "policy_1.json", to="crazyflie").run(tmp_path / "app")
    app = (tmp_path / "app" / "src" / "maidenflight.c").read_text()
    assert "static float full = 65535.0f;" in app
    share = re.search(
        r"^#define MF_HOVER (\S+)f ",
        (tmp_path / "app" / "src" / "policy.h").read_text(),
        re.MULTILINE,
    )
    assert share is not None
    hovers = float(dynamics.hover_command(crazyflie()))
    assert float(share[1]) == pytest.approx(hovers, abs=1e-6)


@pytest.mark.parametrize("ahead", [LookAhead(), LookAhead(2, 0.2)])
def test_a_look_ahead_is_trained_with_and_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ahead: LookAhead
) -> None:
    asked: list[PolicySpec] = []

    def training(*given: Any, policy: PolicySpec, **named: Any) -> tuple[Policy]:
        asked.append(policy)
        return no_training(*given, policy=policy, **named)

    monkeypatch.setattr(TRAINING, training)
    Train(
        drone="crazyflie",
        policies=1,
        hidden=(8,),
        look_ahead=ahead.points,
        look_ahead_spacing=ahead.spacing,
    ).run(tmp_path)
    assert asked == [PolicySpec(look_ahead=ahead, hidden=(8,))]
    file = policy_file.read_policy(tmp_path / "policy_1.json")
    assert file.spec.look_ahead == ahead
    settings = file.record["settings"]
    assert (settings["look_ahead"], settings["look_ahead_spacing"]) == (ahead.points, ahead.spacing)


def test_a_record_says_what_a_policy_of_from_has_and_not_what_is_usual(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = PolicySpec(history=3, look_ahead=LookAhead(2, 0.2), memory=4, hidden=(6,))
    start = untrained_policy(jax.random.key(0), control.attitude().interface, spec)
    policy_file.write_policy(tmp_path / "start.json", start)
    monkeypatch.setattr(TRAINING, no_training)
    Train(drone="crazyflie", policies=1, initial=tmp_path / "start.json").run(tmp_path)
    settings = policy_file.read_policy(tmp_path / "policy_1.json").record["settings"]
    said = {
        "control": "attitude",
        "history": 3,
        "look_ahead": 2,
        "look_ahead_spacing": 0.2,
        "memory": 4,
        "hidden": [6],
        "from": "start.json",
    }
    assert {name: settings[name] for name in said} == said


@pytest.mark.parametrize("structure", CONTROLS)
@pytest.mark.parametrize("task", TASKS)
def test_a_record_says_over_which_drones_policies_were_trained_by_default(
    structure: str, task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(TRAINING, no_training)
    Train(drone="crazyflie", policies=1, control=structure, task=task).run(tmp_path)
    settings = policy_file.read_policy(tmp_path / "policy_1.json").record["settings"]
    assert settings["randomize"] == defaults.choose_randomization(task, structure)


@pytest.mark.parametrize(
    ("target", "paper_scales", "papers"),
    [("authors", False, True), ("c", False, False), (None, True, True)],
)
def test_policies_for_the_authors_format_have_the_papers_scales(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    target: str | None,
    paper_scales: bool,
    papers: bool,
) -> None:
    monkeypatch.setattr(TRAINING, no_training)
    train = Train(
        drone="crazyflie",
        policies=1,
        randomize=0.1,
        control="attitude",
        target=target,
        paper_scales=paper_scales,
    )
    (made,) = train.run(tmp_path).value
    assert (made.interface == control.attitude().interface) == papers
    said = policy_file.read_policy(tmp_path / "policy_1.json").record["settings"]
    assert said["paper_scales"] == papers


def test_each_score_moves_the_bar_and_is_a_line_where_there_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def training(*given: Any, on_progress: Any, **named: Any) -> tuple[Policy]:
        made = no_training(*given, on_progress=on_progress, **named)
        on_progress(Progress(9, 9, Evaluation(*jnp.zeros((4, 1)))))
        return made

    moves: list[Any] = []
    monkeypatch.setattr(Bar, "move", lambda _, *arguments: moves.append(arguments))
    monkeypatch.setattr(TRAINING, training)
    train = Train(drone="crazyflie", policies=1, updates=9, randomize=0.1, hidden=(8,))
    train.run(tmp_path, Bar("train"))
    line = "return 0.0, survival 0% (0.0 s), error 0.0 cm"
    assert moves == [
        (0, 9, "compiling"),
        (1, 9, line),
        (9, 9, line),
        (9, 9, "flying the drone and others about it"),
    ]
    lines = ["0 of 9: compiling", f"1 of 9: {line}", f"9 of 9: {line}"]
    assert capsys.readouterr().err.splitlines() == [f"update {text}" for text in lines]


def test_what_the_target_could_not_hold_is_not_trained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def trained(*_: Any, **__: Any) -> None:
        raise AssertionError("training began")

    monkeypatch.setattr(TRAINING, trained)
    asked: dict[str, Any] = {"drone": "crazyflie", "policies": 1, "randomize": 0.1}
    large: dict[str, Any] = asked | {"hidden": (128, 128)}
    with pytest.raises(InputError, match="22016 multiplications"):
        Train(**large, target="crazyflie").run(tmp_path)
    with pytest.raises(InputError, match=r"look_ahead = .*2.*, but the authors' policies"):
        Train(**asked, look_ahead=2, target="authors").run(tmp_path)
    with pytest.raises(AssertionError, match="training began"):
        Train(**large, target="c").run(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_policy_that_falls_is_said_and_its_file_and_the_manifest_say_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def two(task: Any, controller: Controller, *given: Any, **named: Any) -> tuple[Policy, ...]:
        named["on_progress"](Progress(1, 1, Evaluation(*jnp.zeros((4, 2)))))
        keys = jax.random.split(jax.random.key(0))
        return tuple(untrained_policy(key, controller.interface, named["policy"]) for key in keys)

    monkeypatch.setattr(TRAINING, two)
    result = Train(drone="crazyflie", policies=2, hidden=(8,)).run(tmp_path)
    assert result.content["flies"] == [True, False]
    lines = [line for line in result.summary if isinstance(line, str)]
    assert any("far 1 of 2" in line for line in lines)
    assert any("8.1 s" in line for line in lines)
    good, bad = (policy_file.read_policy(tmp_path / f"policy_{n}.json") for n in (1, 2))
    assert good.doubts == []
    (doubt,) = bad.doubts
    assert "1 of 1" in doubt
    manifested = manifest.read_manifest(tmp_path.parent).entries[-1]
    assert manifested.settings["falls"] == {"2": doubt}
    exported = Export(policy=tmp_path / "policy_2.json").run(tmp_path / "c")
    assert doubt in exported.notes


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"control": "attitude_rate"}, 0.1),
        ({"control": "attitude_rate", "method": "ppo"}, 0.1),
        ({"control": "attitude_rate", "method": "gradient-paper"}, 0.0),
        ({"control": "attitude_rate", "yaw_penalty": 0.0}, 0.0),
        ({}, 0.0),
    ],
)
def test_yaw_costs_by_default_where_a_policy_turns_itself_but_not_in_the_papers_methods(
    given: dict[str, Any], expected: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks: list[str] = []

    def training(task: Any, *given: Any, **named: Any) -> tuple[Policy]:
        tasks.append(task.name)
        return no_training(task, *given, **named)

    monkeypatch.setattr(TRAINING, training)
    Train(drone="crazyflie", policies=1, hidden=(8,), **given).run(tmp_path)
    settings = policy_file.read_policy(tmp_path / "policy_1.json").record["settings"]
    assert settings["yaw_penalty"] == expected
    assert tasks == ["circle" if expected == 0.0 else f"circle, yaw penalty {expected:g}"]


def test_by_default_what_falls_is_trained_on_from_where_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second of two policies of attitude rate falls after 600 updates, not after 1,500."""
    asked: list[tuple[int, Any, bool]] = []
    starts: list[Any] = []

    def training(
        task: Any, controller: Controller, *given: Any, **named: Any
    ) -> tuple[Policy, ...]:
        updates, saved = given[2].updates, named["checkpoint"]
        asked.append((updates, saved.members, saved.restart))
        starts.append(task.reset)
        known = jnp.array([saved.members is None, True])
        score = jnp.where(known, 0.5, jnp.nan)
        named["on_progress"](Progress(updates, 1, Evaluation(*[score] * 4)))
        keys = jax.random.split(jax.random.key(0))
        return tuple(untrained_policy(key, controller.interface, named["policy"]) for key in keys)

    flown = [[flights_of(True, True, lasts) for lasts in (True, now)] for now in (False, True)]
    monkeypatch.setattr(TRAINING, training)
    monkeypatch.setattr(FLIGHTS, lambda *_: flown[len(asked) - 1])
    command = Train(drone="crazyflie", policies=2, control="attitude_rate", hidden=(8,))
    result = command.run(tmp_path)
    assert asked == [(600, None, True), (1500, [1], False)]
    usual = find_task("circle").reset
    assert [start is usual for start in starts] == [True, False], "what fell starts turned"
    assert result.content["flies"] == [True, True]
    files = [policy_file.read_policy(tmp_path / f"policy_{n}.json") for n in (1, 2)]
    assert [file.record["settings"]["updates"] for file in files] == [600, 1500]
    assert not any(file.doubts for file in files)
    asked.clear()
    monkeypatch.setattr(FLIGHTS, lambda *_: flown[0])
    given = Train(drone="crazyflie", policies=2, control="attitude_rate", updates=600, hidden=(8,))
    assert given.run(tmp_path / "given").content["flies"] == [True, False]
    assert asked == [(600, None, True)], "what is given is kept to"
