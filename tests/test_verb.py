"""A verb is declared once: the command line, studies, records and Python follow its fields."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import maidenflight
from maidenflight import cli, verb
from maidenflight.cli.command import VerbCommand
from maidenflight.errors import InputError
from maidenflight.registry import VERBS
from maidenflight.settings import REQUIRED, plain
from maidenflight.studies import study
from maidenflight.verb import find_verb

ROOT = Path(maidenflight.__file__).parent
ONLY_OF_COMMANDS = {
    "verbose",
    "yes",
    "trust",
    "map_columns",
    "resume",
    "status",
    "list",
    "recover",
}
"""Settings on which no result depends: how work is resumed, watched or only looked at."""


def run(*words: Any) -> None:
    cli.commands([*map(str, words)], prog_name="maidenflight", standalone_mode=False)


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
        "jax cflib onnx onnxruntime numpy scipy sklearn polars rich optax tomlkit gymnasium "
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


def test_a_bar_moves_before_anything_heavy_is_imported(tmp_path: Path) -> None:
    program = (
        "import sys; sys.argv = ['maidenflight', *'train --drone crazyflie'.split()]\n"
        "from maidenflight import cli, terminal\n"
        "terminal.Bar.__enter__ = lambda bar: sys.exit(int('jax' in sys.modules))\n"
        "cli.main()"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=tmp_path)


def test_unknown_verbs_and_settings_are_refused() -> None:
    train = find_verb("train")
    with pytest.raises(InputError, match="sed is no setting of train"):
        train.from_settings({"sed": 1})
    with pytest.raises(InputError, match="no such verb"):
        find_verb("soar")
    with pytest.raises(InputError, match="is a int"):
        find_verb("os:O_RDONLY")
    assert isinstance(train.from_settings({"drone": "crazyflie"}), verb.Verb)
