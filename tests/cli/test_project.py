"""A folder's `maidenflight.toml` sets what data may set, in every command, and nothing else."""

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from commands import Command
from maidenflight.cli import project
from maidenflight.errors import InputError
from maidenflight.flights.flight_plan import Block, FlightPlan
from maidenflight.flights.manoeuvres import Manoeuvre
from maidenflight.registry import VERBS
from maidenflight.settings import Setting, find_code
from maidenflight.verb import find_verb

FIELDS = [
    (verb, name, setting)
    for verb in VERBS.own
    for name, (_, setting) in find_verb(verb).settings().items()
]
CONSENT = {
    *(("fly", name) for name in ("yes", "no_propeller_test", "tilt", "rate", "distance")),
    *(("app", name) for name in ("host", "password_file")),
    *(("sweep", name) for name in ("trust", "on", "slurm")),
    *((verb, "accept_bounds") for verb in ("plan", "record", "train", "transfer", "predict")),
    ("envelope", "accept_bounds"),
}
"""What only who runs a command answers."""
EVIL = "open('touched', 'w').close()\n"
CODE = ("stranger:thing", "stranger:thing@crazyflie", "stranger:thing+10ms", "sub.stranger:thing")


def ids(field: Any) -> str:
    return field if isinstance(field, str) else ""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A stranger's folder, in which a module would leave a trace if it were imported."""
    (tmp_path / "sub").mkdir()
    for name in ("stranger.py", "sub/stranger.py", "sub/__init__.py"):
        (tmp_path / name).write_text(EVIL)
    (tmp_path / "study.toml").write_text('[[task]]\nname = "a"\nkind = "record"\n')
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    assert not (tmp_path / "touched").exists()


def test_what_only_users_answer_is_declared_so() -> None:
    assert {(verb, name) for verb, name, setting in FIELDS if setting.consent} == CONSENT


def text_of(value: Any) -> str:
    """A value as TOML; dictionaries inline."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name} = {text_of(one)}' for name, one in value.items())}}}"
    return json.dumps(value)


def values_of(setting: Setting) -> list[Any]:
    """Values that a setting takes, or may."""
    if setting.values.accepts(True):
        return [True]
    numbers = [value for value in (1, 3, 10, 100) if setting.values.accepts(value)]
    return [*numbers, "local", ["local"], {"account": "lab"}]


def refusal(verb: str, name: str, value: Any) -> str:
    """Why a command takes no such value from the file; nothing if it takes it."""
    kind = find_verb(verb)
    try:
        taken = project.settings_for(kind, {verb: {name: value}})
        kind.settings()[name][1].check(taken[name], name)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("verb", "name", "setting"), FIELDS, ids=ids)
def test_no_field_of_a_file_answers_for_users_or_names_code(
    verb: str, name: str, setting: Setting, folder: Path
) -> None:
    for value in values_of(setting) if setting.consent else ():
        assert "for who runs the command to say" in refusal(verb, name, value)
    for code in CODE:
        for value in (code, [code], {"a": code}, [[code]]):
            # What is taken names no code: a path, or a text that is looked up among known ones.
            assert refusal(verb, name, value) or find_code(setting.values, value) is None


def taken(setting: Setting) -> Any:
    """The name of code as a setting takes it, a text or a list of texts; none if it takes none."""
    for value in (CODE[0], [CODE[0]]):
        with suppress(ValueError):
            if setting.values.accepts(value):
                return value
    return None


@pytest.mark.parametrize("verb", [one for one in VERBS.own if one not in ("demo", "doctor")])
def test_no_command_imports_what_a_file_names(verb: str, folder: Path, command: Command) -> None:
    """Not by any text or list of texts, whatever it is declared to be."""
    for name, (_, setting) in find_verb(verb).settings().items():
        if (value := taken(setting)) is None:
            continue
        (folder / project.FILE).write_text(f"[{verb}]\n{name} = {text_of(value)}\n")
        words = {"transfer": "pid", "predict": "pid", "envelope": "pid", "sweep": "nothing.toml"}
        code, out, _ = command(verb, words.get(verb, "") if name != "policies" else "")
        assert (code, out) == (2, ""), name


def refusal_above(verb: str, name: str) -> str:
    with pytest.raises(InputError) as caught:
        project.settings_for(find_verb(verb), {name: CODE[0]})
    return str(caught.value)


@pytest.mark.parametrize("name", project.SHARED)
def test_nothing_above_all_tables_names_code(name: str) -> None:
    for verb in project.SHARED[name]:
        assert "names Python code" in refusal_above(verb, name)


def test_code_is_refused_by_name_and_may_be_given_on_the_command_line(
    folder: Path, command: Command
) -> None:
    file = folder / project.FILE
    for text, option in (
        ('task = "stranger:thing"', "--task stranger:thing"),
        ('[train]\nrandomize = "stranger:thing"', "--randomize stranger:thing"),
        ('[train]\ncontrol = "stranger:thing"', "--control stranger:thing"),
    ):
        file.write_text(text)
        code, _, err = command("train --drone crazyflie")
        assert code == 2
        assert f"give {option} if you mean it" in err
    file.write_text('[transfer]\nreality = ["stranger:thing"]')
    assert "names Python code, stranger:thing" in command("transfer policies")[2]


def test_code_is_found_at_any_depth_and_only_where_it_is_meant() -> None:
    train = {name: one.values for name, (_, one) in find_verb("train").settings().items()}
    transfer = {name: one.values for name, (_, one) in find_verb("transfer").settings().items()}
    assert find_code(train["task"], [{"a": ["mine:task"]}]) == "mine:task"
    assert find_code(train["task"], "circle") is None
    assert find_code(transfer["reality"], ["virtual:7", "mine:Make+10ms"]) == "mine:Make+10ms"
    assert find_code(transfer["reality"], ["virtual:7+10ms", "crazyflow:cf2x"]) is None


SETTINGS = 'drone = "crazyflie"\ntask = "hover"\ncontrol = "attitude"\n'


@pytest.mark.parametrize("verb", VERBS.own)
def test_documented_settings_fit_every_command(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They make no command refuse what it takes without them."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / project.FILE).write_text(SETTINGS)
    given: dict[str, Any] = {
        name: {"drone": "crazyflie", "policies": ["pid"], "logs": "flights"}.get(name, "x")
        for name, (_, one) in find_verb(verb).settings().items()
        if one.argument and not one.values.repeats
    }
    taken = project.settings_for(find_verb(verb), project.read_project())
    known = {name for name, verbs in project.SHARED.items() if verb in verbs}
    assert taken.keys() == known
    made = find_verb(verb).from_settings({**taken, **given, **_required(verb)})
    made.check_early()
    for name in taken:
        assert getattr(made, find_verb(verb).settings()[name][0]) == taken[name]


def _required(verb: str) -> dict[str, Any]:
    """What a command must be given."""
    policies = {"policies": ["pid"]}
    return {
        "transfer": policies,
        "predict": policies,
        "envelope": policies,
        "match": policies,
        "fly": {"uri": "radio://0/80/2M"},
    }.get(verb, {})


def test_a_drone_above_all_tables_is_no_table_of_the_command_drone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / project.FILE).write_text(SETTINGS)
    assert command("drone crazyflie")[0] == 0
    assert command("drone --list")[0] == 0
    code, _, err = command("report nowhere")
    assert code == 2
    assert "crazyflie" not in err


def test_an_unknown_setting_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / project.FILE).write_text("[train]\nsteps = 3\n")
    with pytest.raises(InputError, match=r"\[train\] steps; expected"):
        project.settings_for(find_verb("train"), project.read_project())


def test_a_plan_that_names_code_as_its_drone_runs_none(folder: Path, command: Command) -> None:
    blocks = (Block(Manoeuvre("hover"), 2.0),)
    record = {"settings": {"drone": "stranger:x"}}
    FlightPlan(blocks, (2.0, 2.0, 1.5), 0.8, record=record).write(folder / "plan.toml")
    code, out, err = command("record --plan plan.toml")
    assert (code, out) == (2, "")
    assert "give --reality stranger:x if you mean it" in err


def test_a_study_that_names_code_as_a_plans_drone_needs_trust(
    folder: Path, command: Command
) -> None:
    for part in ('settings = { drone = "stranger:x" }', 'grid = { drone = ["stranger:x"] }'):
        (folder / "study.toml").write_text(f'[[task]]\nname = "a"\nkind = "plan"\n{part}\n')
        code, out, err = command("sweep study.toml --status")
        assert (code, out) == (2, "")
        assert "--trust" in err


def test_a_file_of_the_name_does_not_hide_code(folder: Path, command: Command) -> None:
    """A study is checked in one folder and computed in another."""
    (folder / "stranger:thing").write_text("")
    inner = folder / "inner"
    inner.mkdir()
    (inner / "stranger.py").write_text(f"open({str(folder / 'touched')!r}, 'w').close()")
    task = '[[task]]\nname = "a"\nkind = "record"\nsettings = { reality = "stranger:thing" }\n'
    (inner / "study.toml").write_text(task)
    assert "--trust" in command("sweep inner/study.toml")[2]
