"""`Quantity`: what is known of one physical constant besides its value."""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Quantity:
    """What is known of one physical constant besides its value."""

    symbol: str
    unit: str
    """SI; "-" for a pure number."""
    lower: float
    """Smallest value with a physical meaning."""
    upper: float
    """Largest plausible value for a drone of 5 g to 5 kg."""
    meaning: str
    source: str
    """Where the model or the named drone's value comes from."""
    table: str
    """The table of the TOML file in which it stands."""
    size: int = 1
    """Number of components."""


def quantity(
    table: str,
    symbol: str,
    unit: str,
    bounds: tuple[float, float],
    meaning: str,
    source: str,
    size: int = 1,
) -> Any:
    """Returns a field of `Parameters`, with what is known of it; see `Quantity`."""
    return field(
        metadata={"quantity": Quantity(symbol, unit, *bounds, meaning, source, table, size)}
    )
