"""Settings of identification, whose class chooses the method.

`Likelihood` looks one row ahead, or at sensors alone, and models what it cannot predict. `Replay`
is the paper's: it looks many rows ahead, open loop.
"""

from dataclasses import dataclass
from typing import Any

from maidenflight.errors import InputError
from maidenflight.flights.windows import LEAD_IN

METHODS = ("gradient", "bayesian")
"""Optimisers of a replay. The first finds the same optimum as the paper's, the second, in a tenth
of the time or less."""
DISCOUNT = 0.95
"""delta, weight of each later step over the one before (Gronauer et al. 2022, sec. Simulation
Optimization)."""


@dataclass(frozen=True)
class Likelihood:
    """Settings of identification by likelihood."""

    trials: int = 2
    """Repetitions of the optimiser. The first begins at the start, the others at random."""
    evaluations: int = 60
    """Most evaluations of the likelihood in a trial; it stops by itself after two to six."""
    lead_in: int = LEAD_IN
    """Rows of commands before a window, from which its motors' speed is inferred."""
    physics_step: float = 0.0025
    """Mean physics step [s], or half a row where that is shorter. None sees two commands, so that
    more of them change nothing; with 5 ms motors of 20 ms come out 2 % short."""
    pilot_windows: int = 128
    """Windows on which a random start comes near the optimum."""

    def __post_init__(self) -> None:
        """Refuses what makes no sense."""
        _must_be_positive(self)


@dataclass(frozen=True)
class Replay:
    """Settings of identification by replay."""

    method: str = METHODS[0]
    """`gradient`, which follows derivatives through the simulator, or `bayesian`, the paper's."""
    length: int = 30
    """T, rows of a window (Gronauer et al. 2022, sec. Simulation Optimization)."""
    lead_in: int = LEAD_IN
    """Rows of commands before a window, from which its motors' speed is inferred. With 0 motors and
    delay line begin at rest; the authors' code takes five, and half thrust in the delay line."""
    discount: float = DISCOUNT
    """delta, weight of each row over the one before."""
    trials: int = 2
    """Repetitions of the optimiser, each from a random start; the paper made three."""
    evaluations: int = 60
    """Most evaluations of the objective in a trial. Bayesian optimisation spends them all, the
    paper 250; the gradient method stops by itself."""

    def __post_init__(self) -> None:
        """Refuses what makes no sense."""
        if self.method not in METHODS:
            raise InputError(
                f"unknown method {self.method!r} of a replay; known are {', '.join(METHODS)}."
            )
        _must_be_positive(self, or_zero="lead_in")


def _must_be_positive(settings: Any, or_zero: str = "") -> None:
    for name, value in vars(settings).items():
        usable = not isinstance(value, int | float) or value > 0
        if not usable and (name, value) != (or_zero, 0):
            raise InputError(
                f"{type(settings).__name__}({name}={value!r}); expected a positive number."
            )
