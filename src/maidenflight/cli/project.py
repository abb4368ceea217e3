"""A folder's own settings: `maidenflight.toml` holds what its commands need no options for."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.registry import VERBS
from maidenflight.verb import Verb

FILE = "maidenflight.toml"
SHARED = ("drone", "task", "control")
"""Settings that stand above all tables, for every command that has them as an option."""


def read_project() -> dict[str, Any]:
    """Reads the file in the present folder; empty where there is none.

    Raises:
        InputError: the file is no TOML, or names no command.
    """
    if not Path(FILE).is_file():
        return {}
    content = inputs.toml_file(FILE, "TOML", "Correct it.")
    for name, value in content.items():
        if isinstance(value, dict) and name in VERBS:
            continue
        if name not in SHARED or isinstance(value, dict):
            raise InputError(
                f"{FILE}: {name}; expected {', '.join(SHARED)}, or a table with the name of a "
                "command, such as [train]."
            )
    return content


def settings_for(verb: type[Verb], content: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a command's settings of the file's content.

    Those of the command's own table count more than those above all tables, which fill no
    argument. TOML has no table of the command `drone` beside a drone above all tables.

    Raises:
        InputError: its table names no setting.
    """
    declared = {name: one for name, (_, one) in verb.settings().items()}
    own = content.get(verb.name, {})
    for name in own:
        if name not in declared:
            raise InputError(f"{FILE}: [{verb.name}] {name}; expected {', '.join(declared)}.")
    shared = {
        name: content[name]
        for name in SHARED
        if name in content and name in declared and not declared[name].argument
    }
    return {**shared, **own}
