"""What an identification is asked for, whatever its method."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.identification.estimates import Source
from maidenflight.identification.progress import Reporter
from maidenflight.parameters import Parameters


@dataclass(frozen=True)
class Problem:
    """Flights, parameters to identify from them, and where to begin."""

    flights: Sequence[Flight]
    """Checked flights of one rate, at least one."""
    source: Source
    """What is recorded of them."""
    start: Parameters
    """Where the first trial begins, and what is kept of the other parameters."""
    over: tuple[str, ...] | None
    """Names of the parameters to identify; `None`: the flights choose."""
    bounds: Mapping[str, tuple[float, float]]
    """Search bounds by name, SI units, in place of the method's."""
    generator: np.random.Generator
    """Random numbers."""
    reporter: Reporter
    """What is told how far it is."""


def must_tell(names: Collection[str], untold: Collection[str]) -> None:
    """Refuses flights that tell nothing of what is asked for.

    Args:
        names: parameters that they tell.
        untold: the others.

    Raises:
        InputError: there are no `names`.
    """
    if not names:
        raise InputError(
            f"these flights cannot tell {', '.join(untold)}: intervals are as wide as what is "
            "plausible without them. Fly with more excitation."
        )


def must_be_positive(settings: Any) -> None:
    """Refuses settings with a number that is not positive.

    Raises:
        InputError: names the setting and its value.
    """
    for name, value in vars(settings).items():
        if isinstance(value, int | float) and not value > 0:
            raise InputError(
                f"{type(settings).__name__}({name}={value!r}); expected a positive number."
            )
