"""Settings that every training method has, and how records say them."""

from collections.abc import Mapping
from dataclasses import Field, asdict, fields, replace
from typing import Any, ClassVar, Protocol

from maidenflight.errors import InputError
from maidenflight.settings import plain


class Settings(Protocol):
    """Settings that every method has; frozen dataclasses and pytrees."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def updates(self) -> int:
        """Gradient steps, or epochs."""
        ...

    @property
    def evaluations(self) -> int:
        """How often the policy is evaluated; the best one counts."""
        ...

    @property
    def episodes(self) -> int:
        """Episodes per evaluation."""
        ...

    @property
    def num_envs(self) -> int:
        """Environments simulated in parallel."""
        ...

    @property
    def horizon(self) -> int:
        """Control periods per environment and update."""
        ...


def check_counts(settings: Settings) -> None:
    """Refuses numbers of steps, environments and evaluations below 1.

    Raises:
        InputError: as above.
    """
    for name in ("updates", "evaluations", "episodes", "num_envs", "horizon"):
        value = getattr(settings, name)
        # Within a compiled program they are no numbers.
        if isinstance(value, int) and value < 1:
            raise InputError(f"{type(settings).__name__}: {name} = {value}; expected 1 or more.")


def recorded(settings: Settings) -> dict[str, Any]:
    """Returns settings as plain values, for records."""
    return plain(asdict(settings))


def override(settings: Settings, numbers: Mapping[str, float]) -> Settings:
    """Returns settings with other numbers, by the names of fields.

    Raises:
        InputError: there is no such number, or it is a whole one.
    """
    values = {field.name: getattr(settings, field.name) for field in fields(settings)}
    changes: dict[str, Any] = {}
    for name, value in numbers.items():
        if type(values.get(name)) not in (int, float):
            method = type(settings).__name__
            raise InputError(f"learner: {name} is no number of {method}: {', '.join(values)}.")
        whole = isinstance(values[name], int)
        if whole and value != int(value):
            raise InputError(f"learner: {name} = {value:g}; expected a whole number.")
        changes[name] = int(value) if whole else value
    return replace(settings, **changes)
