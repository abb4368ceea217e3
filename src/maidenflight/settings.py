"""Settings of a verb: which values each takes, its default, its unit and its help.

A setting is declared once, as a field of a `verb.Verb`. The command line's options, the checks of a
study, records and the arguments in Python are derived from it.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from maidenflight.errors import InputError
from maidenflight.inputs import is_number
from maidenflight.registry import Registry

REQUIRED: Any = object()
"""Default of a setting that is required."""
PENDING: Any = object()
"""Value of a setting that another task of a study has yet to make."""


@dataclass(frozen=True)
class Values:
    """The values that a setting takes, as typed values and as words of a command line."""

    expected: str
    """What a value is, for errors."""
    accepts: Callable[[Any], bool]
    """Whether a typed value, as of TOML or Python, is one."""
    parse: Callable[[str], Any] = str
    """Reads a value from a word of the command line; raises ValueError where it cannot."""
    convert: Callable[[Any], Any] = lambda value: value
    """Converts a value that is accepted into the one that the verb sees."""
    metavar: str = "TEXT"
    """What the command line's help shows in its place."""
    choices: tuple[str, ...] = ()
    """All values, where these are a few texts."""
    span: tuple[float, float] | None = None
    """Least and most, where these are numbers alone."""
    repeats: bool = False
    """Whether the command line's option is repeated, a word each."""
    names_code: Callable[[str], bool] = lambda text: False
    """Whether a text among them names Python code, which no file that others may have written
    sets."""

    def check(self, value: Any) -> Any:
        """Returns the value that the verb sees.

        Raises:
            ValueError: it is none of these values.
        """
        if not self.accepts(value):
            raise ValueError(value)
        return self.convert(value)


def whole(low: int, high: int) -> Values:
    """Takes whole numbers within two others."""
    return Values(
        f"a whole number from {low} to {high}",
        lambda value: type(value) is int and low <= value <= high,
        int,
        metavar="INTEGER",
        span=(low, high),
    )


def number(low: float, high: float, unit: str = "") -> Values:
    """Takes numbers within two others, of a unit that errors name."""
    return Values(
        f"a number from {low:g} to {high:g} {unit}".rstrip(),
        lambda value: is_number(value) and low <= value <= high,
        float,
        float,
        "NUMBER",
        span=(low, high),
    )


def choice(*names: str) -> Values:
    """Takes one of some texts."""
    return Values(
        f"one of {', '.join(names)}",
        lambda value: isinstance(value, str) and value in names,
        metavar=f"[{'|'.join(names)}]",
        choices=names,
    )


def name_of(registry: Registry) -> Values:
    """Takes names of a registry, to which installed packages may add."""
    own = tuple(registry.own)
    return Values(
        f"one of {', '.join(own)}, or what an installed package adds",
        lambda value: isinstance(value, str) and value in registry,
        metavar=f"[{'|'.join(own)}|...]",
        choices=own,
    )


def text(expected: str = "a text", metavar: str = "TEXT") -> Values:
    """Takes texts that are not empty."""
    return Values(expected, lambda value: isinstance(value, str) and value != "", metavar=metavar)


def path(expected: str = "a path", metavar: str = "PATH") -> Values:
    """Takes paths of files or folders."""
    return Values(
        expected,
        lambda value: isinstance(value, str | Path) and str(value) != "",
        convert=Path,
        metavar=metavar,
    )


def flag() -> Values:
    """Takes true and false."""
    return Values("true or false", lambda value: isinstance(value, bool), metavar="")


def several(entry: Values, expected: str = "", empty: bool = False) -> Values:
    """Takes lists of values; the command line repeats the option.

    Args:
        entry: of the list's entries.
        expected: what they are, for errors.
        empty: whether the list may be empty.
    """
    return Values(
        expected or f"a list, each {entry.expected}",
        lambda value: (
            isinstance(value, list | tuple)
            and (empty or len(value) > 0)
            and all(map(entry.accepts, value))
        ),
        entry.parse,
        lambda value: tuple(map(entry.convert, value)),
        entry.metavar,
        entry.choices,
        repeats=True,
        names_code=entry.names_code,
    )


def listed(
    entry: Values, expected: str, metavar: str, separator: str = ",", count: int | None = None
) -> Values:
    """Takes lists of values, any number or `count`; the command line has one word for all."""
    values = several(entry, expected)
    return dataclasses.replace(
        values,
        accepts=lambda value: values.accepts(value) and count in (None, len(value)),
        parse=lambda word: [entry.parse(part.strip()) for part in word.split(separator)],
        metavar=metavar,
        choices=(),
        repeats=False,
    )


def either(values: Values, *words: str) -> Values:
    """Takes some words, and other values beside them."""

    def parse(word: str) -> Any:
        return word if word in words else values.parse(word)

    def is_word(value: Any) -> bool:
        return isinstance(value, str) and value in words

    return dataclasses.replace(
        values,
        expected=f"{', '.join(words)}, or {values.expected}",
        accepts=lambda value: is_word(value) or values.accepts(value),
        parse=parse,
        convert=lambda value: value if is_word(value) else values.convert(value),
        metavar=f"[{'|'.join(words)}|{values.metavar}]",
        span=None,
    )


def or_code(values: Values) -> Values:
    """Takes names of Python code, `MODULE:NAME`, and other values beside them."""
    return dataclasses.replace(
        values,
        expected=f"{values.expected}, or MODULE:NAME of your own",
        accepts=lambda value: is_code(value) or values.accepts(value),
        parse=lambda word: word if is_code(word) else values.parse(word),
        convert=lambda value: value if is_code(value) else values.convert(value),
        metavar=f"{values.metavar.removesuffix(']')}|MODULE:NAME]",
        span=None,
        names_code=lambda text: is_code(text) or values.names_code(text),
    )


def is_code(value: Any) -> bool:
    """Tests whether a setting's value names Python code, `MODULE:NAME`."""
    module, mark, name = value.partition(":") if isinstance(value, str) else ("", "", "")
    parts = [*module.split("."), name]
    return bool(mark) and all(part.isidentifier() for part in parts)


def table(entry: Values, expected: str, metavar: str = "NAME=VALUE") -> Values:
    """Takes a value by name, each; the command line repeats `NAME=VALUE`."""

    def parse(word: str) -> tuple[str, Any]:
        name, mark, value = word.partition("=")
        if not name or not mark:
            raise ValueError(word)
        return name, entry.parse(value)

    def pairs(value: Any) -> Sequence[tuple[str, Any]]:
        return list(value.items()) if isinstance(value, Mapping) else value

    return Values(
        expected,
        lambda value: (
            isinstance(value, Mapping | list | tuple)
            and all(isinstance(name, str) and entry.accepts(each) for name, each in pairs(value))
        ),
        parse,
        lambda value: {name: entry.convert(each) for name, each in pairs(value)},
        metavar,
        repeats=True,
        names_code=entry.names_code,
    )


def find_code(values: Values, value: Any) -> str | None:
    """Returns the first text in a value, or in what it holds, that names Python code."""
    if isinstance(value, str):
        return value if values.names_code(value) else None
    inner = value.values() if isinstance(value, Mapping) else value
    if not isinstance(value, Mapping | list | tuple):
        return None
    return next((code for entry in inner if (code := find_code(values, entry))), None)


@dataclass(frozen=True)
class Setting:
    """A setting of a verb."""

    values: Values
    default: Any
    help: str
    name: str = ""
    """As users write it, where the field's own name would be a keyword of Python."""
    group: str = ""
    """Heading of the command line's help under which it stands; that of the setting before it
    by default."""
    usual: str = ""
    """What help shows as its default, where that depends on others."""
    argument: bool = False
    """Whether the command line takes it by its place."""
    rare: bool = False
    """Whether only `--help-all` shows it."""
    files: bool = False
    """Whether its values name files or folders, or may; their content then names a result."""
    producer: str = ""
    """The verb whose task in a study may make it."""
    consent: bool = False
    """Whether it answers a question of trust or safety: nobody but who runs the command may."""
    recorded: bool = True
    """Whether results depend on it: records hold it, and a study may set it."""

    @property
    def default_text(self) -> str:
        """Returns its default as help shows it; nothing where that says nothing."""
        if self.usual or self.default in (None, REQUIRED, "", (), {}):
            return self.usual
        value = self.default
        return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)

    def check(self, value: Any, label: str) -> Any:
        """Returns the value that the verb sees.

        Raises:
            InputError: the setting takes no such value, or has none; `label` names it.
        """
        if value is REQUIRED:
            raise InputError(f"{label} is missing; expected {self.values.expected}.")
        if value is PENDING:
            return value
        endless = isinstance(value, float) and not math.isfinite(value)
        alike = isinstance(value, bool) == isinstance(self.default, bool)  # False equals 0
        compared = self.default is not REQUIRED and alike and not endless
        if compared and plain(value) == plain(self.default):
            return self.default
        try:
            return self.values.check(value)
        except (ValueError, TypeError, OverflowError):
            wrong = f"{label} = {str(value)[:60]!r}"
            hint = similar(str(value), self.values.choices)
            raise InputError(f"{wrong}; {hint}expected {self.values.expected}.") from None


def similar(word: str, names: Iterable[str]) -> str:
    """Returns the question whether a name was meant that a word resembles; else nothing."""
    found = get_close_matches(word, names, 1)
    return f"did you mean {found[0]}? " if found else ""


def setting(
    values: Values, default: Any = REQUIRED, help: str = "", group: str = "", **more: Any
) -> Any:
    """Declares a setting, a field of a verb; see `Setting` for the arguments."""
    metadata = {"setting": Setting(values, default, help, group=group, **more)}
    if isinstance(default, dict):
        return dataclasses.field(default_factory=lambda: dict(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def plain(value: Any) -> Any:
    """Converts a setting's value to what JSON and TOML hold; numbers without end become None."""
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {name: plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
