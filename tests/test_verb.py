"""A verb is declared once: the command line, studies, records and Python follow its fields."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import pytest

import maidenflight
from maidenflight import cli, verb
from maidenflight.cli.command import VerbCommand
from maidenflight.errors import InputError
from maidenflight.registry import VERBS
from maidenflight.settings import REQUIRED, plain
from maidenflight.studies import study
from maidenflight.verb import Verb, find_verb

ROOT = Path(maidenflight.__file__).parent
ONLY_OF_COMMANDS = {
    "verbose",
    "trust",
    "map_columns",
    "resume",
    "view",
    "status",
    "list",
    "recover",
}
"""Settings on which no result depends: how work is resumed, watched or only looked at."""
OPTION = """    patience: int = setting(whole(1, 9), 2, "How long to wait [h].")
"""
SOURCE = '''"""`Wait`: nothing."""

from pathlib import Path

from maidenflight.settings import setting, whole
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import shared


class Wait(Verb):
    """Wait for better weather."""

    output = Output("waited.txt", "File for what came of it.")

    seed: int = shared.seed()
{option}
    def compute(self, output: Path, progress: Progress) -> Result:
        """Writes its record."""
        record = self.make_record()
        output.write_text(str(record["settings"]))
        return Result(
            content=record["settings"],
            written={{"picture": [output]}},
            record=record,
            rows=[record["settings"]],
        )
'''


def run(*words: Any) -> None:
    cli.commands([*map(str, words)], prog_name="maidenflight", standalone_mode=False)


@pytest.fixture
def wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Makes a verb of one file, with an option or without, and its line in the registry."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))

    def make(name: str, option: str = "") -> type[Verb]:
        (tmp_path / f"{name}.py").write_text(SOURCE.format(option=option))
        monkeypatch.setitem(VERBS.own, "wait", f"{name}:Wait")
        return find_verb("wait")

    return make


def test_a_new_verb_is_one_file_and_a_line_in_the_registry(wait: Any, capsys: Any) -> None:
    made = wait("waiting")
    run("wait", "--json", "--seed", 3)
    assert json.loads(capsys.readouterr().out) == {}
    assert Path("waited.txt").exists()
    assert made().run("again.txt").record["seed"] == 0
    (task,) = study.of([{"name": "a", "kind": "wait", "settings": {"seed": 4}}]).tasks
    assert task.settings == {"seed": 4}
    run("--help")
    assert "Wait for better weather." in capsys.readouterr().out


def test_a_new_option_is_one_line_in_one_file(wait: Any, capsys: Any) -> None:
    """It is in the help, the command line, a study with its range, the record and Python."""
    made = wait("waiting_longer", OPTION)
    run("wait", "--help")
    out = " ".join(capsys.readouterr().out.split())
    assert "--patience INTEGER How long to wait [h]. [default: 2]" in out
    run("wait", "--patience", 5, "--json")
    assert json.loads(capsys.readouterr().out) == {"patience": 5}
    with pytest.raises(click.BadParameter, match="from 1 to 9"):
        run("wait", "--patience", 10, "--overwrite")
    assert made(patience=7).run("python.txt").record["settings"] == {"patience": 7}
    with pytest.raises(InputError, match="patience = '0'"):
        made(patience=0)
    found = study.of([{"name": "a", "kind": "wait", "grid": {"patience": [1, 2]}}]).tasks
    assert [task.settings["patience"] for task in found] == [1, 2]
    with pytest.raises(InputError, match="patience = '0'"):
        study.of([{"name": "a", "kind": "wait", "settings": {"patience": 0}}])


@pytest.mark.parametrize("name", VERBS.own)
def test_a_study_sets_every_setting_of_a_verb_that_shapes_its_result(name: str) -> None:
    made = find_verb(name)
    every = set(made.settings())
    assert set(study.settings_of(made)) == every - ONLY_OF_COMMANDS
    assert all(made.settings()[one][1].recorded is False for one in every & ONLY_OF_COMMANDS)


@pytest.mark.parametrize("name", VERBS.own)
def test_the_command_line_sets_every_setting_of_a_verb(name: str) -> None:
    made = find_verb(name)
    command = VerbCommand(made)
    words = {parameter.name for parameter in command.params}
    assert {one.rstrip("_") for one in words if one} >= set(made.settings())
    flags = {flag for parameter in command.params for flag in parameter.opts}
    assert {"-o", "--output", "--json"} <= flags
    assert ("--seed" in flags) == ("seed" in made.settings())


@pytest.mark.parametrize("name", VERBS.own)
def test_defaults_are_values_that_the_setting_takes(name: str) -> None:
    for setting, (_, declared) in find_verb(name).settings().items():
        assert declared.producer in ("", *VERBS.own)
        if declared.default not in (REQUIRED, None, (), {}):
            value = declared.check(plain(declared.default), setting)
            assert plain(value) == plain(declared.default)


@pytest.mark.parametrize("name", VERBS.own)
def test_the_help_of_a_verb_fits_a_screen_of_50_lines(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    run(name, "--help")
    shown = capsys.readouterr().out
    assert len(shown.splitlines()) <= 50
    rare = [one for one, (_, declared) in find_verb(name).settings().items() if declared.rare]
    assert ("--help-all" in shown) == bool(rare)
    if rare:
        run(name, "--help-all")
        every = capsys.readouterr().out
        for one in rare:
            assert f"--{one.replace('_', '-')}" in every
            assert f"--{one.replace('_', '-')} " not in shown


@pytest.mark.parametrize("words", [[], *([name] for name in VERBS.own)], ids=" ".join)
def test_help_imports_nothing_heavy(words: list[str]) -> None:
    """By what is imported, and not by the time it takes, which is for benchmarks."""
    heavy = (
        "jax cflib onnx onnxruntime numpy scipy sklearn polars rerun rich optax tomlkit gymnasium "
        "pybullet tensorboardX wandb ray submitit fsspec"
    ).split()
    program = (
        f"import sys; sys.argv = ['maidenflight', *{words}, '--help']\n"
        "from maidenflight import cli\n"
        "try: cli.main()\n"
        f"finally: print('HEAVY', [name for name in {heavy} if name in sys.modules],\n"
        "               len([name for name in sys.modules if name.startswith('maidenflight')]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": ""},
    )
    last = done.stdout.splitlines()[-1]
    assert last.startswith("HEAVY []"), done.stdout + done.stderr
    assert int(last.split()[-1]) <= 32 + len(VERBS.own) * (not words)


def test_unknown_verbs_and_settings_are_refused() -> None:
    train = find_verb("train")
    with pytest.raises(InputError, match="sed is no setting of train"):
        train.from_settings({"sed": 1})
    with pytest.raises(InputError, match="no such verb"):
        find_verb("soar")
    with pytest.raises(InputError, match="is a int"):
        find_verb("os:O_RDONLY")
    assert isinstance(train.from_settings({"drone": "crazyflie"}), verb.Verb)
