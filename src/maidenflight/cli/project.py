"""A folder's own settings: `maidenflight.toml` holds what its commands need no options for.

A folder may come from anybody. So this file sets what data may set: nothing in it names code, and
nothing answers a question of trust or safety, which who runs the command does.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.registry import VERBS
from maidenflight.settings import Setting, find_code
from maidenflight.verb import Verb

FILE = "maidenflight.toml"
_FLY = ("transfer", "predict", "envelope")
SHARED: Mapping[str, tuple[str, ...]] = {
    "drone": ("train", *_FLY),
    "task": ("train", *_FLY),
    "control": ("train",),
}
"""Settings that stand above all tables, and the commands that take them: `drone`, `validate` and
`plan` have their drone as an argument, `report` and `fly` another meaning of it."""


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

    Those of the command's own table count more than those above all tables. TOML has no table of
    the command `drone` beside a drone above all tables.

    Raises:
        InputError: its table names no setting, or one that only the command line sets.
    """
    declared = {name: setting for name, (_, setting) in verb.settings().items()}
    table = content.get(verb.name, {})
    own = table if isinstance(table, dict) else {}
    shared = {
        name: content[name]
        for name, verbs in SHARED.items()
        if name in content and verb.name in verbs and name in declared
    }
    for name in own:
        if name not in declared:
            raise InputError(f"{FILE}: [{verb.name}] {name}; expected {', '.join(declared)}.")
    settings = {**shared, **own}
    for name, value in settings.items():
        _refuse_what_only_users_say(name, declared[name], value)
    return settings


def _refuse_what_only_users_say(name: str, setting: Setting, value: Any) -> None:
    """Refuses answers to questions of trust or safety, and names of code."""
    option = name if setting.argument else f"--{name.replace('_', '-')}"
    if setting.consent:
        raise InputError(
            f"{FILE}: {name} is for who runs the command to say, since a folder may come from "
            f"anybody. Remove it there, and give {option} if you mean it."
        )
    if code := find_code(setting.values, value):
        raise InputError(
            f"{FILE}: {name} names Python code, {code}, which anybody may have written. Remove it "
            f"there, look at the code, and give {option} {code} if you mean it."
        )
