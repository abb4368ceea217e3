"""The command, the drones that may be a firmware's physics, and the words of the package."""

import ast
import re
import shlex
from pathlib import Path

import click
import pytest

from maidenflight import cli
from maidenflight.errors import InputError
from maidenflight.simulator.realities.reality import reality
from maidenflight_plant.running_plant import find_plant, plant_of

ROOT = Path(__file__).parents[1]


def test_a_plant_is_refused_at_once_where_the_drone_changes_in_flight() -> None:
    assert callable(find_plant("virtual:1+yaw600", 0))
    with pytest.raises(InputError, match="virtual:1"):
        find_plant("virtual:1+yaw600@1", 0)
    with pytest.raises(InputError, match="near:7"):
        plant_of(reality("near:7+weak10@5"), 65535.0)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("virtual:7 --udp nowhere", "HOST:PORT"),
        ("virtual:7 --pipe --crazysim", "exclude"),
        ("virtual:7 --duration 0", "0.001 to 86400"),
        ("nothing:7 --pipe", "nothing"),
    ],
)
def test_a_command_that_makes_no_sense_is_refused(words: str, named: str) -> None:
    with pytest.raises((InputError, click.UsageError), match=named):
        cli.commands(["plant", *words.split()], prog_name="maidenflight", standalone_mode=False)


def test_the_commands_of_the_page_are_ones_that_there_are() -> None:
    page = (ROOT / "README.md").read_text()
    lines = re.findall(r"^maidenflight (.*)$", page, re.M)
    assert len(lines) == 3
    for line in lines:
        name, *words = shlex.split(line, comments=True)
        command = cli.commands.get_command(click.Context(cli.commands), name)
        assert command is not None
        command.parse_args(click.Context(command, info_name=name), words)


def test_it_uses_public_names_alone() -> None:
    for file in ROOT.rglob("src/**/*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = []
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("maidenflight"):
                names = [*str(node.module).split("."), *(one.name for one in node.names)]
            assert not [name for name in names if name.startswith("_")], file
