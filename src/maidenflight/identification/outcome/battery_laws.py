"""Doubt about the battery law: thrust by each law that may have made a log's PWM, averaged.

Where a log does not name its law, commands are read by the most plausible one. Another law would
give other commands to the same motors' voltages: its thrust-to-weight ratio is in inverse
proportion to their mean, and torques, so inertia, to their slope. Samples of the posterior are
drawn over the laws by their probability: what is usual, and how steady thrust per command is.

Source: Hoeting et al. 1999, Bayesian model averaging: a tutorial.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight.flights import compensation
from maidenflight.flights.checkup.in_flight import thrust_per_command
from maidenflight.flights.log import Flight
from maidenflight.identification.drone_file import Estimate
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.posterior import Posterior
from maidenflight.identification.uncertainty import LEVEL, interval
from maidenflight.identification.unknowns import UNKNOWNS

_BLOCKS, _MOST = 20.0, 5.0
"""Blocks of half a second to an independent one, since laws miss by what lasts as long as a
battery; and most of them, since no law is exact: of five NanoBench flights whose thrust names the
law, thrust per command is steadier by another one in three. Harmless within a factor of 1.4
(paper/identification/constants.py)."""


class LawChance(NamedTuple):
    """A battery law that may have made some logs."""

    law: str
    """A key of `compensation.LAWS`."""
    probability: float
    thrust: float
    """Thrust-to-weight ratio by it over that by the law taken."""
    torque: float
    """Torque of a command likewise."""


def law_chances(flights: Sequence[Flight]) -> list[LawChance]:
    """Returns the laws that flights may be read by, the one taken first.

    Args:
        flights: checked flights.

    Returns:
        None of flights that name their law, or were not read by one.
    """
    doubtful = [
        flight for flight in flights if flight.assumed_law and np.isfinite(flight.battery).any()
    ]
    if not doubtful:
        return []
    assumed_law = str(doubtful[0].assumed_law)
    command = np.concatenate([flight.command for flight in doubtful]).astype(float)
    volts = np.concatenate([flight.battery for flight in doubtful]).astype(float)
    flying = np.isfinite(volts) & (command > 0.02).all(axis=1)
    if not flying.any():
        return []
    command, volts = command[flying], volts[flying]
    own, spread = np.log(command), _spread(doubtful, assumed_law)
    chances = []
    for law, usual in compensation.usual_laws(command, volts, assumed_law).items():
        other = np.maximum(compensation.reread(command, volts, assumed_law, law), 1e-3)
        slope = float(np.polyfit(own.ravel(), np.log(other).ravel(), 1)[0])
        blocks, deviation = _spread(doubtful, assumed_law, law)
        steady = (spread[1] / max(deviation, 1e-6)) ** min(blocks / _BLOCKS, _MOST)
        ratio = float(command.mean() / other.mean())
        chances.append(LawChance(law, usual * steady, ratio, slope))
    total = sum(chance.probability for chance in chances)
    chances = [chance._replace(probability=chance.probability / total) for chance in chances]
    # What a tail of the interval holds cannot move its end.
    least = (1 - LEVEL) / 2
    return [chance for chance in chances if chance.law == assumed_law or chance.probability > least]


def _spread(
    flights: Sequence[Flight], assumed_law: str, law: str | None = None
) -> tuple[int, float]:
    """Number of blocks, and standard deviation of the logarithm of thrust per command in them."""
    if law not in (None, assumed_law):
        flights = [
            replace(log, command=compensation.reread(log.command, log.battery, assumed_law, law))
            for log in flights
        ]
    blocks = thrust_per_command(flights)
    blocks = blocks[np.isfinite(blocks)]
    return len(blocks), float(np.std(blocks)) if len(blocks) else 1.0


def average_laws(
    result: Identification, flights: Sequence[Flight], generator: np.random.Generator
) -> Identification:
    """Returns an identification whose samples and intervals hold the doubt about the battery law.

    Args:
        result: by the law that was taken, whose values stay.
        flights: checked flights.
        generator: random numbers.
    """
    chances = law_chances(flights)
    if len(chances) < 2 or HOVERING not in result.posterior:
        return result
    weights = np.array([chance.probability for chance in chances])
    count = len(result.posterior[HOVERING])
    drawn = generator.choice(len(chances), count, p=weights / weights.sum())
    thrust = np.array([chance.thrust for chance in chances])[drawn]
    torque = np.array([chance.torque for chance in chances])[drawn]
    torques = [name for name in result.posterior if UNKNOWNS[name].is_torque]
    factors = {HOVERING: thrust, **dict.fromkeys(torques, torque)}
    samples = {name: values * factors.get(name, 1.0) for name, values in result.posterior.items()}
    estimates = {
        name: _widened(estimate, samples[name]) if name in factors else estimate
        for name, estimate in result.estimates.items()
    }
    value = float(result.parameters.thrust_to_weight)
    laws = ", ".join(
        f"{chance.thrust * value:.3g} by the law of the {chance.law} "
        f"({100 * chance.probability:.0f} %)"
        for chance in chances
    )
    # Full PWM gives more than u = 1 where the battery has more than this.
    full = float(compensation.motor_volts(np.array(1.0), chances[0].law))
    volts = float(np.nanmean(np.concatenate([flight.battery for flight in flights])))
    note = (
        f"the log does not name its battery law: thrust_to_weight is {laws}; intervals hold them. "
        f"It is that of u = 1, {full:.2f} V at the motors, {100 * full / volts:.0f} % PWM at the "
        f"flights' {volts:.2f} V. Give --battery-law if you know it (--help-all)."
    )
    return replace(
        result, posterior=Posterior(samples), estimates=estimates, notes=(note, *result.notes)
    )


def _widened(estimate: Estimate, samples: Float[np.ndarray, "N"]) -> Estimate:
    low, high = interval(samples)
    ends = min(float(low), estimate.value), max(float(high), estimate.value)
    return replace(estimate, interval=ends)
