"""Forms derived from the settings of verbs, and the words of a command from what they hold."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import click

from maidenflight.cli.command import VerbCommand
from maidenflight.errors import InputError
from maidenflight.registry import VERBS
from maidenflight.settings import Setting, flag, path
from maidenflight.verb import Verb, find_verb

FLOW = ("log", "identify", "validate", "train", "transfer", "predict", "export", "drone", "report")
"""Verbs that lead from logs to the drone; others are below them."""
_APART = ("app", "fly")
"""The page itself, and what asks for a hand at the keyboard while a real drone flies."""


def verbs() -> dict[str, type[Verb]]:
    """Returns the verbs with a form, those of the flow first; packages may add some."""
    names = [*FLOW, *(name for name in VERBS if name not in FLOW)]
    return {name: find_verb(name) for name in names if name not in _APART}


def fields(verb: type[Verb]) -> dict[str, Setting]:
    """Returns the fields of a verb's form by name, with those that every command has.

    A question of trust or safety has none: only who runs a command answers it.
    """
    settings = {name: one for name, (_, one) in verb.settings().items() if not one.consent}
    place, help = verb.output, "Replace results of an earlier run."
    output = Setting(path(), None, place.help, usual=place.default or "", group="Output")
    settings["output"] = replace(output, rare=place.default is not None)
    return settings | ({"overwrite": Setting(flag(), False, help)} if verb.replaces else {})


def kind_of(setting: Setting) -> str:
    """Returns which control a field is."""
    values = setting.values
    if isinstance(setting.default, bool):
        return "flag"
    if values.choices:
        return "choices" if values.repeats else "choice"
    return "lines" if values.repeats else "number" if values.span else "text"


def words_of(
    verb: type[Verb], filled: Mapping[str, Any], check: Callable[[str], object]
) -> list[str]:
    """Returns the words of the command for what a form holds.

    Args:
        verb: of the form.
        filled: true or false, a text, or a list of texts by field; an empty one is left out.
        check: called with each text.

    Raises:
        InputError: there is no such field, or a text names Python code.
    """
    known, arguments, options = fields(verb), list[str](), list[str]()
    for name, value in filled.items():
        if name not in known:
            raise InputError(f"{name}: no field of {verb.name}. Reload the page.")
        option, setting = f"--{name.replace('_', '-')}", known[name]
        if kind_of(setting) == "flag":
            options += [option] if value is True else []
            continue
        texts = value if isinstance(value, list) else [value]
        for text in (one.strip() for one in texts if isinstance(one, str) and one.strip()):
            if any(map(setting.values.names_code, (text, text.partition("=")[2]))):
                raise InputError(
                    f"{option} {text} names Python code, which the page does not run. Look at the "
                    "code, and give it on the command line if you mean it."
                )
            check(text)
            arguments += [text] if setting.argument else []
            options += [] if setting.argument else [f"{option}={text}"]
    return [*options, "--", *arguments]


def fill_by(words: Sequence[str]) -> dict[str, list[str]]:
    """Returns what fields hold by the words of a command; one in capitals only the user knows."""
    command = VerbCommand(find_verb(words[0]))
    try:
        context = command.make_context(words[0], [*words[1:]], resilient_parsing=True)
    except click.ClickException:
        return {}
    filled = {}
    for name, value in context.params.items():
        several = value if isinstance(value, list | tuple) else [value]
        texts = [str(one) for one in several if one is not None and not str(one).isupper()]
        if texts and not isinstance(value, bool | dict):
            filled[name.rstrip("_")] = texts
    return filled
