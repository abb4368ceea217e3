"""What is known of a physical constant, beside its value."""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Quantity:
    """What is known of one physical constant."""

    symbol: str
    unit: str
    """SI; "-" for a pure number."""
    paper: Any
    """The value of the paper's Crazyflie: a number, or one of each component."""
    lower: float
    """Smallest value with a physical meaning."""
    upper: float
    """Largest plausible value for a drone of 5 g to 5 kg."""
    meaning: str
    source: str
    """Where the model or the named drone's value comes from."""
    table: str
    """The table of the TOML file in which it stands."""

    @property
    def size(self) -> int:
        """Number of components."""
        return len(self.paper) if isinstance(self.paper, tuple) else 1


def quantity(
    table: str,
    label: str,
    paper: Any,
    bounds: tuple[float, float],
    meaning: str,
    source: str,
) -> Any:
    """Returns a field of `Parameters`, with what is known of it; labelled as `T_m [s]`."""
    symbol, _, unit = label.removesuffix("]").partition(" [")
    return field(
        metadata={"quantity": Quantity(symbol, unit, paper, *bounds, meaning, source, table)}
    )
