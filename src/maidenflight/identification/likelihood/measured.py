"""What signals show of some parameters by themselves, of logs with and without a state.

Measured rotor speeds show the motors' lag both ways, their latency and, with the body rates, the
inertia. Without them commands and gyro show the equivalent lag, and inertia over thrust.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight
from maidenflight.identification.likelihood.speed_errors import motors_of_speeds
from maidenflight.identification.outcome.plausible import HOVERING
from maidenflight.identification.outcome.problem import Problem
from maidenflight.identification.outcome.progress import MOTOR_LAG
from maidenflight.identification.signals.lag import DELAYS, LAG, SLOWING_DOWN, speeding_up
from maidenflight.identification.signals.motor_response import (
    MotorResponse,
    estimate_motor_response,
    is_clear,
)
from maidenflight.identification.signals.speed_inertia import inertia_of_speeds
from maidenflight.identification.uncertainty import RESAMPLES, Evidence, of_samples
from maidenflight.parameters import Parameters

Samples = Mapping[str, Float[np.ndarray, "N"]]
"""Of a posterior, by parameter, SI units."""


@dataclass(frozen=True)
class Measured:
    """What signals show by themselves."""

    motors: MotorResponse | None = None
    """None where nothing shows them."""
    inertia: Samples = field(default_factory=dict)
    """By measured speeds; nothing of an axis of which they show none."""

    @property
    def delays(self) -> Samples:
        """Samples of equivalent lag, latency and, where speeds show it, the ratio of lags."""
        if self.motors is None:
            return {}
        ratio = self.motors.spin_down_ratio
        samples = {LAG: self.motors.lag, "latency": self.motors.latency}
        return samples if ratio is None else samples | {SLOWING_DOWN: ratio}

    def evidence(self, thrust: float) -> list[Evidence]:
        """Returns what they say of inertia, at a ratio of thrust to weight."""
        loop = self.motors.inertia_per_thrust if self.motors else {}
        by_loop = {name: thrust * samples for name, samples in loop.items()}
        return [
            *of_samples("rates by speeds", self.inertia),
            *of_samples("loop gain", by_loop),
        ]

    def motor_samples(self, generator: np.random.Generator) -> Samples:
        """Returns the same with the lag speeding up, `RESAMPLES` of each.

        Where nothing shows the ratio of lags, it is taken as one.
        """
        samples = dict(self.delays)
        samples[LAG] = speeding_up(samples[LAG], samples.get(SLOWING_DOWN, 1.0))
        chosen = generator.integers(len(samples[LAG]), size=RESAMPLES)
        return {name: values[chosen] for name, values in samples.items()}


def measure(problem: Problem) -> Measured:
    """Returns what signals show by themselves, if the motors' lag and latency are requested.

    Nothing where a policy flew at the log's rate: the likelihood of one row ahead models those
    flights exactly, and shows the motors better.
    """
    flights, report = problem.flights, partial(problem.reporter.stage, MOTOR_LAG)
    if problem.over is not None and not set(DELAYS) <= set(problem.over):
        return Measured()
    report(0, 0)
    if all(flight.zero_order_hold and flight.accelerometer is None for flight in flights):
        return Measured()
    motors = motors_of_speeds(flights, problem.start, problem.generator, problem.reporter.evaluated)
    if motors is None:
        generator = problem.generator.spawn(1)[0]
        motors = estimate_motor_response(flights, generator, problem.start, report)
    inertia: Samples = {}
    if problem.over is None:
        generator = problem.generator.spawn(1)[0]
        inertia = inertia_of_speeds(flights, problem.start, RESAMPLES, generator)
    return Measured(motors, inertia)


def inertia_of_loop(
    flights: Sequence[Flight],
    motors: MotorResponse,
    known: Samples,
    drone: Parameters,
    generator: np.random.Generator,
) -> dict[str, Float[np.ndarray, "N"]]:
    """Returns samples of inertia by the gain of the loop, where it tells that clearly.

    It does for planted PX4 drones of which the gyro's likelihood leaves it untold; where that tells
    it, the loop is worse (paper/notes/identification.md).

    Args:
        flights: of which a loop shows the inertia at one of the commands.
        motors: what they show of the motors.
        known: samples of other parameters, such as the thrust-to-weight ratio.
        drone: its ratio is used where that is not known.
        generator: random numbers.
    """
    if not motors.is_identifiable:
        return {}
    thrust = known.get(HOVERING, np.full(RESAMPLES, float(drone.thrust_to_weight)))
    # A command turns the drone by the slope of the thrust's curve, of which each sample has that at
    # one of the flight's commands: it is not known at which one a loop shows.
    linear = known.get("thrust_linear", float(drone.thrust_linear))
    commands = np.concatenate([flight.command.mean(axis=1) for flight in flights])
    chosen = generator.choice(commands.clip(0.01), RESAMPLES)
    slope = 1.0 - float(drone.thrust_offset) + linear * (0.5 / np.sqrt(chosen) - 1.0)
    thrust = thrust * np.maximum(slope, 0.1)
    inertia = {
        name: generator.choice(samples, RESAMPLES) * thrust
        for name, samples in motors.inertia_per_thrust.items()
    }
    return {name: samples for name, samples in inertia.items() if is_clear(samples)}
