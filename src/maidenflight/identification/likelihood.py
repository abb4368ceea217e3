"""The likelihood of flights by one-step errors, which feedback does not bias.

`Likelihood` holds the settings of identification by it, `most_likely` finds the drone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from maidenflight.flights.log import Flight
from maidenflight.flights.windows import LEAD_IN, windows
from maidenflight.identification import one_step
from maidenflight.identification.flight_signals import sharp, stride
from maidenflight.identification.one_step import OneStep
from maidenflight.identification.problem import must_be_positive
from maidenflight.parameters import Parameters


@dataclass(frozen=True)
class Likelihood:
    """Settings of identification by likelihood."""

    trials: int = 2
    """Repetitions of the optimiser. The first begins at the start, the others at random."""
    evaluations: int = 60
    """Most evaluations of the likelihood in a trial; it stops by itself after two to six."""
    lead_in: int = LEAD_IN
    """Rows of commands before a window, from which its motors' speed is inferred."""
    physics_step: float = 0.001
    """Nominal physics step [s] of the last steps of the optimiser. At 5 ms a command that arrives
    within a step is resolved so coarsely that the lag comes out 1 ms short."""
    coarse_physics_step: float = 0.0033
    """Nominal physics step [s] before that, and where parameters are chosen: a third less work than
    2 ms, and the same choice. With 5 ms, flights without noise choose others."""
    pilot_windows: int = 128
    """Windows on which a random start comes near the optimum."""

    def __post_init__(self) -> None:
        """Refuses what makes no sense."""
        must_be_positive(self)


def log_likelihood(
    flights: Sequence[Flight], drone: Parameters, settings: Likelihood | None = None
) -> float:
    """Mean log likelihood of a row [nats] of flights under a drone and the best noise model.

    Args:
        flights: checked flights of one rate.
        drone: the drone; its noise does not count.
        settings: uses `lead_in` and `physics_step`; `Likelihood()` unless given.

    Raises:
        InputError: too little flight.
    """
    settings = Likelihood() if settings is None else settings
    return -one_step_objective(flights, settings, settings.physics_step)(drone)


def coarse_objective(flights: Sequence[Flight], settings: Likelihood | None = None) -> OneStep:
    """The objective by which information is judged before a fit, on all windows.

    Args:
        flights: checked flights of one rate; where they show the motors, the gyro's delay is
            undone.
        settings: uses `lead_in` and `coarse_physics_step`; `Likelihood()` unless given.

    Raises:
        InputError: too little flight.
    """
    settings = Likelihood() if settings is None else settings
    if all(one.accelerometer is not None or one.rotor_speed is not None for one in flights):
        flights = [sharp(flight) for flight in flights]
    return one_step_objective(flights, settings, settings.coarse_physics_step)


def one_step_objective(
    flights: Sequence[Flight], settings: Likelihood, step: float, every: int = 1
) -> OneStep:
    """The objective on each `every`-th window, in physics steps of about `step` seconds.

    Args:
        flights: checked flights of one rate.
        settings: uses `lead_in`.
        step: nominal physics step [s].
        every: windows from one that counts to the next.

    Raises:
        InputError: too little flight.
    """
    rows, period = stride(flights[0]), flights[0].period
    cut = windows(
        flights,
        one_step.LENGTH,
        every=one_step.LENGTH,
        lead_in=settings.lead_in,
        stride=rows,
    )
    return OneStep(
        type(cut)(*(array[::every] for array in cut)), period, max(1, round(period / step)), rows
    )
