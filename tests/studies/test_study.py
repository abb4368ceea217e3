import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
import toy_kinds
from toy_kinds import entry

from maidenflight.errors import InputError
from maidenflight.studies import study
from maidenflight.studies.study import Task


def tasks(entries: list[dict[str, Any]], home: Path, cpus: int = 1) -> tuple[Task, ...]:
    return study.of(entries, home, cpus=cpus).tasks


def test_a_grid_is_taken_point_by_point_and_inputs_bring_theirs(tmp_path: Path) -> None:
    found = tasks(toy_kinds.study(count=3, more=2), tmp_path)
    assert [task.name for task in found] == ["squared"] * 3 + ["added"] * 6
    assert [dict(task.point) for task in found[3:5]] == [
        {"squared.value": 1, "added.more": 0},
        {"squared.value": 1, "added.more": 1},
    ]
    assert found[3].inputs == {"square": found[0].key}
    assert found[-1].inputs == {"square": found[2].key}
    assert len({task.key for task in found}) == 9


def test_inputs_with_an_entry_in_common_agree_on_its_point(tmp_path: Path) -> None:
    (tmp_path / "logs.csv").write_text("log")
    found = tasks(
        [
            entry("drone", "identify", {"logs": "logs.csv"}, {"seed": [0, 1]}),
            entry("policy", "train", grid={"control": ["pwm", "attitude"]}, drone="drone"),
            entry("times", "predict", drone="drone", policies="policy"),
        ],
        tmp_path,
    )
    assert [task.name for task in found] == ["drone"] * 2 + ["policy"] * 4 + ["times"] * 4
    for task in found[-4:]:
        (made,) = [one for one in found if one.key == task.inputs["policies"]]
        assert made.inputs["drone"] == task.inputs["drone"]
        assert made.point == task.point


def test_a_key_is_of_settings_files_inputs_and_devices_alone(tmp_path: Path) -> None:
    first, second = tmp_path / "one", tmp_path / "two"
    for home in (first, second):
        home.mkdir()
        (home / "logs.csv").write_text("log")
    read = entry("a", "identify", {"logs": "logs.csv"})
    (one,) = tasks([read], first)
    (other,) = tasks([{**read, "name": "b"}], second)
    assert one.key == other.key
    spelt = {**read, "settings": {"logs": "logs.csv", "seed": 0}}
    assert tasks([spelt], first)[0].key == one.key
    assert tasks([{**read, "settings": {"logs": "logs.csv", "seed": 1}}], first)[0].key != one.key
    assert tasks([read], first, cpus=2)[0].key != one.key
    (second / "logs.csv").write_text("another log")
    assert tasks([read], second)[0].key != one.key


def test_a_study_is_read_from_toml(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(
        '[[task]]\nname = "policy"\nkind = "train"\n'
        'settings = { drone = "crazyflie", policies = 2 }\n'
        "grid = { seed = { first = 3, count = 2 } }\n"
    )
    found = study.read_study(path)
    assert [task.point for task in found.tasks] == [{"policy.seed": 3}, {"policy.seed": 4}]
    assert found.tasks[0].settings["policies"] == 2
    assert found.home == tmp_path
    assert json.dumps(found.entries)


@pytest.mark.parametrize(
    ("setting", "code"),
    [
        ('kind = "evil:Verb"', "evil:Verb"),
        ('kind = "transfer"\nsettings = { reality = ["virtual:7", "evil:f+10ms"] }', "evil:f+10ms"),
        ('kind = "transfer"\ngrid = { reality = ["evil:f"] }', "evil:f"),
        ('kind = "transfer"\ngrid = { policies = ["evil:f"] }', "evil:f"),
        ('kind = "train"\nsettings = { drone = "crazyflie", task = "evil:t" }', "evil:t"),
    ],
    ids=["verb", "reality", "grid", "policies", "task"],
)
def test_code_that_a_file_names_is_imported_with_trust_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, setting: str, code: str
) -> None:
    (tmp_path / "evil.py").write_text("raise SystemExit('imported')")
    (tmp_path / "study.toml").write_text(f'[[task]]\nname = "a"\n{setting}\n')
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(InputError, match=re.escape(code)):
        study.read_study(tmp_path / "study.toml")
    with pytest.raises((SystemExit, InputError)) as raised:
        study.read_study(tmp_path / "study.toml", trust=True)
    assert "trust" not in str(raised.value)


GOOD: dict[str, Any] = {"name": "a", "kind": "train", "settings": {"drone": "crazyflie"}}


def good(**changes: Any) -> list[dict[str, Any]]:
    """An entry in which something is changed."""
    return [{**GOOD, **changes}]


def drone(**settings: Any) -> list[dict[str, Any]]:
    """An entry with further settings."""
    return good(settings={"drone": "crazyflie", **settings})


MANY = {"seed": {"first": 0, "count": 1001}, "policies": list(range(1, 1001))}


@pytest.mark.parametrize(
    ("entries", "told"),
    [
        ([], "no tasks"),
        ([3], "expected a table"),
        (good(grids={}), "grids is unknown"),
        ([{"kind": "train"}], "name = None"),
        ([GOOD, GOOD], "name = 'a'"),
        (good(kind="soar"), "'soar': no such verb"),
        (good(kind="fly"), "fly is no task of a study"),
        (good(kind="toy_kinds:none"), "toy_kinds has no Verb 'none'"),
        (good(kind=".toy_kinds:Square"), "cannot be imported"),
        (good(kind="toy_kinds:another"), "is a int"),
        (good(settings=3), "expected a table"),
        (good(settings={}), "no file drone.toml"),
        (drone(sed=1), "sed is no setting"),
        (drone(policies=0), "policies = '0'"),
        (drone(policies=True), "policies = 'True'"),
        (drone(randomize="far"), "randomize"),
        (drone(rate=math.nan), "rate = 'nan'"),
        (drone(drone="crazyflee"), "crazyflee"),
        (drone(drone="a" * 5000), "aaa"),
        ([GOOD, entry("b", "transfer", {"reality": ["b" * 5000]}, policies="a")], "bbb"),
        (drone(drone="my.toml"), "no file my.toml"),
        (good(grid={"drone": ["crazyflie"]}), "drone is set twice"),
        (good(grid={"seed": []}), "grid seed"),
        (good(grid={"seed": [1, 1]}), "twice"),
        (good(grid={"seed": {"first": 0}}), "grid seed"),
        (good(grid={"seed": [1, -1]}), "seed = '-1'"),
        (good(grid=MANY), "more than"),
        ([GOOD, entry("b", "transfer", policies="c")], "above it"),
        ([GOOD, entry("b", "transfer") | {"inputs": {"policies": ["a"]}}], "above it"),
        ([GOOD, entry("b", "predict", policies="a", drone="a")], "identify"),
        ([GOOD, entry("b", "train", {"drone": "crazyflie"}, seed="a")], "no task makes seed"),
        ([GOOD, entry("b", "transfer", {"reality": ["nowhere"]}, policies="a")], "nowhere"),
    ],
)
def test_what_is_wrong_in_a_study_is_told_before_anything_runs(
    entries: list[Any], told: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as error:
        study.of(entries, tmp_path, "the.toml")
    assert told in str(error.value)
    assert str(error.value).startswith("the.toml")


@pytest.mark.parametrize("content", ["[[task", "task = 3", 'title = "a"', ""])
def test_a_file_that_is_no_study_is_refused(content: str, tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(content)
    with pytest.raises(InputError):
        study.read_study(path)
    with pytest.raises(InputError):
        study.read_study(tmp_path / "none.toml")


def test_a_grid_sweeps_values_of_a_table(tmp_path: Path) -> None:
    swept = {"set.latency": [0.0, 0.02], "learner.num_envs": [8]}
    policy = entry("policy", "train", {"drone": "crazyflie", "set": {"drag_x": 0.1}}, swept)
    found = tasks([policy], tmp_path)
    assert [task.settings["set"] for task in found] == [
        {"drag_x": 0.1, "latency": 0.0},
        {"drag_x": 0.1, "latency": 0.02},
    ]
    assert found[1].point == {"policy.set.latency": 0.02, "policy.learner.num_envs": 8}
    assert found[1].settings["learner"] == {"num_envs": 8}
    for wrong in ("set.", "seed.latency", "sets.latency"):
        with pytest.raises(InputError):
            tasks([{**policy, "grid": {wrong: [0.02]}}], tmp_path)
    with pytest.raises(InputError, match="latency"):
        tasks([{**policy, "grid": {"set.latency": ["late"]}}], tmp_path)
