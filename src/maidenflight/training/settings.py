"""Settings that every training method has, and how records say them."""

from dataclasses import Field, asdict
from typing import Any, ClassVar, Protocol


class Settings(Protocol):
    """Settings that every method has; frozen dataclasses and pytrees."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def updates(self) -> int:
        """Gradient steps, or epochs."""
        ...

    @property
    def evaluations(self) -> int:
        """How often the policy is evaluated; the best one is kept."""
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


def recorded(settings: Settings) -> dict[str, Any]:
    """Settings as plain values, for records."""
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in asdict(settings).items()
    }
