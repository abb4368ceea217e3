"""Forms derived from the settings of verbs, and the words of a command from what they hold."""

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from maidenflight.errors import InputError
from maidenflight.registry import VERBS
from maidenflight.settings import Setting, flag, path
from maidenflight.verb import Verb, find_verb

FLOW = ("log", "identify", "validate", "train", "transfer", "predict", "export", "drone", "report")
"""Verbs that lead from logs to the drone; others are below them."""
_EXCLUDED = ("app", "fly")
"""The page itself, and what asks for a hand at the keyboard while a real drone flies."""


def verbs() -> dict[str, type[Verb]]:
    """Returns the verbs with a form, those of the flow first; packages may add some."""
    names = [*FLOW, *(name for name in VERBS if name not in FLOW)]
    return {name: find_verb(name) for name in names if name not in _EXCLUDED}


@cache
def fields(verb: type[Verb]) -> dict[str, Setting]:
    """Returns the fields of a verb's form by name, with those that every command has.

    A question of trust or safety has none: only who runs a command answers it.
    """
    settings = {name: field for name, (_, field) in verb.settings().items() if not field.consent}
    target, help = verb.output, "Replace results of an earlier run."
    output = Setting(path(), None, target.help, usual=target.default or "", group="Output")
    settings["output"] = replace(output, rare=target.default is not None)
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
    """Returns the words of the command for what a form holds: a flag, a text or a list by field.

    `check` is called with each text. InputError where there is no such field, or one names code.
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
        for text in (text.strip() for text in texts if isinstance(text, str) and text.strip()):
            if any(map(setting.values.names_code, (text, text.partition("=")[2]))):
                raise InputError(
                    f"{option} {text} names Python code, which the page does not run. Look at the "
                    "code, and give it on the command line if you mean it."
                )
            check(text)
            arguments += [text] if setting.argument else []
            options += [] if setting.argument else [f"{option}={text}"]
    return [*options, *(["--", *arguments] if arguments else [])]


def filled_by(verb: type[Verb], words: Iterable[str]) -> dict[str, list[str]]:
    """Returns what fields hold by the words of a command; one in capitals only the user knows."""
    known, filled, left = fields(verb), dict[str, list[str]](), deque(words)
    places, ended = [name for name, setting in known.items() if setting.argument], False
    while left:
        word, name, text = left.popleft(), places[0] if places else "", ""
        if word == "--" or (word.startswith("-") and not ended):
            ended = word == "--"
            option, mark, text = word.replace("-o", "--output", word == "-o").partition("=")
            name = option.removeprefix("--").replace("-", "_")
            takes = name in known and kind_of(known[name]) != "flag" and not mark and left
            text = left.popleft() if takes else text
        else:
            text, places = word, places[1:] or places
        if name in known and text and not text.isupper():
            filled.setdefault(name, []).append(text)
    return filled
