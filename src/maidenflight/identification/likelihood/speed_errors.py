"""What measured rotor speeds show of the motors: their lag both ways and their latency.

Speeds follow commands through the motors alone, and nothing answers them, so that they are no loop.
A rotor's speed is a parabola of the speed nu that the model's motor has, with numbers of its own in
each segment of flight: motors are unequal, and the battery sags. Nor is the speed that a command
asks for always a multiple of sqrt(u), so that it is found first, as a polynomial of each segment.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d

from maidenflight.flights.log import Flight
from maidenflight.identification.likelihood.fit import fit
from maidenflight.identification.likelihood.sensor_errors import EVALUATIONS, SensorErrors
from maidenflight.identification.likelihood.sensor_signals import Rotors, Sensor
from maidenflight.identification.signals.flight_signals import (
    delay_command,
    is_zero_order_hold,
    means,
)
from maidenflight.identification.signals.lag import DELAYS, SLOWING_DOWN, slope_by_ratio
from maidenflight.identification.signals.motor_response import (
    LATENCY_OF_SPEEDS,
    LIKE,
    OWN,
    QUICK,
    SHORTEST,
    MotorResponse,
    random_effects,
    usual_latency,
)
from maidenflight.identification.uncertainty import DELAY, RESAMPLES, of_samples
from maidenflight.identification.unknowns import physical_bounds, search_box
from maidenflight.parameters import Parameters, component
from maidenflight.parameters import replace as with_values
from maidenflight.simulator.physics.dynamics import equivalent_lag

NAMES = (*DELAYS, SLOWING_DOWN)
"""What the speeds show."""
_START = {"motor_time_constant": 0.04, "latency": 0.003, SLOWING_DOWN: 1.0, "motor_coasting": 0.0}
"""Where the search begins: lags of 24 to 87 ms are found from there
(`python paper/identification/log_rates.py --speeds`)."""
_EXPLAINED = 0.7
"""Share of the speeds' variance that commands must explain, or the reading is broken: of four real
drones they explain 0.88 to 0.93 (paper/notes/truth-board.md)."""
_POWERS, _FITS = np.arange(5), (5, 3, EVALUATIONS)
"""Powers of sqrt(u) of which a segment's asked speed is made, and evaluations of fits, each of what
the one before found: speeds in proportion to sqrt(PWM), read as affine in PWM, have a lag of 30 ms
up and 50 down, of which one fit finds 29.5 and 39, two 29.4 and 45, three 29.4 and 49; chosen."""
_SLOW = 1.0
"""Time over which means are taken of what is slow [s]."""
_SAMPLED = np.array([15.0, 8.0, 1 / np.sqrt(12)])
"""Standard errors of the logarithms of lag and ratio, and of the latency [s], for each second of a
row, where a log samples a faster loop's commands: their noise is taken for steps that last a row.
Lags of 25 to 90 ms are 7 to 27 % off at 100 Hz, ratios 6 to 10 %; at 250 Hz 1 to 3 and 2 to 4 %;
latencies a tenth to a fifth of a row (`python paper/identification/log_rates.py --speeds`)."""


def mean_speed(flight: Flight, rows: int, step: float) -> Float[np.ndarray, "M 4"]:
    """Returns the rotors' speeds [rad/s], means over steps of some rows."""
    speed = np.asarray(flight.rotor_speed, float)
    return means((speed[:-1] + speed[1:]) / 2, rows)


class SpeedErrors(SensorErrors):
    """The rotors' measured speeds, less what commands make of them."""

    sensor = Sensor(0.010, mean_speed)

    def predicted(self, drone: Parameters, rotors: Rotors) -> Float[np.ndarray, "M S 4"]:
        """Returns the parabola of each motor's nu that fits its segment best.

        Source: Golub and Pereyra 1973 (variable projection); Gronauer et al. 2022,
        eq:motor-dynamics (nu).
        """
        terms = np.stack([np.ones_like(rotors.mean), rotors.mean, rotors.square], axis=-1)
        return np.einsum("msri,sri->msr", terms, self._weights(terms))

    def _weights(self, terms: Float[np.ndarray, "M S 4 k"]) -> Float[np.ndarray, "S 4 k"]:
        """Weights of terms whose sum fits a segment's speeds best."""
        counted = terms * self.signals.used[..., None, None]
        matrix = np.einsum("msri,msrj->srij", counted, terms)
        sums = np.einsum("msri,msr->sri", counted, self.signals.measured)
        ridge = 1e-9 * np.trace(matrix, axis1=-2, axis2=-1)[..., None, None]
        matrix += ridge * np.eye(terms.shape[-1])
        return np.linalg.solve(matrix, sums[..., None])[..., 0]

    def linearize_commands(self, drone: Parameters) -> Self:
        """Returns the model whose commands are in proportion to the speeds that they ask for.

        A motor lags behind the speed that is asked for. What lags so behind each power of the
        command adds up to the measured speed, and the powers themselves to the one asked for.

        Args:
            drone: lag both ways and latency.
        """
        signals, rows = self.signals, self.signals.rows
        delayed = delay_command(signals.command, float(drone.latency) / signals.period)
        lag = float(drone.motor_time_constant)
        up = -np.expm1(-signals.period / lag)
        down = -np.expm1(-signals.period / (lag * float(drone.spin_down_ratio)))
        speed = delayed[0, ..., None] ** _POWERS
        terms = np.zeros((len(signals.measured), *speed.shape))
        for row, command in enumerate(delayed):
            away = command[..., None] ** _POWERS - speed
            after = speed + np.where(away[..., 1:2] < 0, down, up) * away
            terms[row // rows] += (speed + after) / (2 * rows)
            speed = after
        powers = signals.command[..., None] ** _POWERS
        targets = np.einsum("nsri,sri->nsr", powers, self._weights(terms))
        return type(self)(replace(signals, command=targets / np.abs(targets).max(axis=0)))

    def explained(self, drone: Parameters) -> float:
        """Returns the share of what speeds do within a second that a drone explains.

        Slower are the battery and the air, which the noise model takes.
        """
        used, rows = self.signals.used, round(_SLOW / self.signals.step)
        error, whole = (
            float(np.var((signal - uniform_filter1d(signal, rows, axis=0))[used], axis=0).sum())
            for signal in (self.errors(drone), self.signals.measured)
        )
        return 1.0 - error / max(whole, 1e-12)


def motors_of_speeds(
    flights: Sequence[Flight],
    drone: Parameters,
    generator: np.random.Generator,
    on_evaluation: Callable[[], None] = lambda: None,
) -> MotorResponse | None:
    """Returns what measured speeds show of the motors; None where they do not follow commands.

    Args:
        flights: those with rotor speeds count.
        drone: what flew; its motors do not matter.
        generator: random numbers.
        on_evaluation: called after each.
    """
    flights = [
        flight
        for flight in flights
        if flight.rotor_speed is not None and flight.duration >= SHORTEST
    ]
    if not flights:
        return None
    start = with_values(drone, **{key: np.float32(value) for key, value in _START.items()})
    box = search_box(NAMES, physical_bounds(start))
    model = SpeedErrors.of(flights)
    # The noise of a faster loop's commands passes for a law where rows are far apart.
    has_law = is_zero_order_hold(flights) or flights[0].period <= QUICK
    fits = _FITS if has_law else (EVALUATIONS,)
    optimum = fit(box, fits[0], [model], start, {}, on_evaluation)
    for evaluations in fits[1:]:
        model = model.linearize_commands(optimum.drone)
        optimum = fit(box, evaluations, [model], optimum.drone, {}, on_evaluation)
    explained = model.explained(optimum.drone)
    if explained < _EXPLAINED:
        return None
    values, variances = _by_segment(optimum.drone, model)
    # No motor is quite of first order; what speeds leave unexplained bounds what that can do.
    left = float(np.sqrt(1.0 - explained))
    least = np.array([min(LIKE, left), min(OWN, left), LATENCY_OF_SPEEDS])
    if not is_zero_order_hold(flights):
        least = np.hypot(least, flights[0].period * _SAMPLED)
    joined = [random_effects(*columns) for columns in zip(values.T, variances.T, strict=True)]
    means, errors = np.array(joined).T
    noise = generator.spawn(1)[0].standard_normal((RESAMPLES, 3))
    log_lag, log_ratio, latency = (means + np.hypot(errors, least) * noise).T
    lag, latency = np.exp(log_lag), np.maximum(latency, 0.0)
    return MotorResponse(
        lag,
        latency,
        usual_latency(flights, latency),
        tuple(of_samples("rotor speed", {DELAY: lag + latency})),
        (),
        _by_log(model.signals.flights, values, variances),
        spin_down_ratio=np.exp(log_ratio),
    )


def _by_segment(
    drone: Parameters, model: SpeedErrors
) -> tuple[Float[np.ndarray, "S 3"], Float[np.ndarray, "S 3"]]:
    """Logarithms of equivalent lag and ratio, and latency [s], by segment, and variances.

    One step of each segment's own.
    """
    _, scores, curvatures = model.derivatives(drone, NAMES)
    lag, latency, ratio = (float(component(drone, name)) for name in NAMES)
    # Of the three by lag speeding up, latency and ratio.
    growth = -slope_by_ratio(drone) / lag
    slope = np.array([[1 / lag, 0.0, growth], [0.0, 0.0, 1 / ratio], [0.0, 1.0, 0.0]])
    # A segment in which nothing happens is as uncertain as these.
    scale = 1 / np.array([lag, 0.1 * lag, ratio])
    scaled = curvatures * model.rows / np.outer(scale, scale)
    inverses = np.linalg.inv(scaled + np.eye(3)) / np.outer(scale, scale)
    steps = -np.einsum("ij,sjk,sk->si", slope, inverses, scores * model.rows)
    here = np.array([np.log(equivalent_lag(lag, ratio)), np.log(ratio), latency])
    return here + steps, np.einsum("ij,sjk,ik->si", slope, inverses, slope)


def _by_log(
    names: Sequence[str], values: Float[np.ndarray, "S 3"], variances: Float[np.ndarray, "S 3"]
) -> dict[str, tuple[float, float]]:
    """Mean and variance of the logarithm of lag and latency together, by log."""
    moments = {}
    for name in dict.fromkeys(names):
        chosen = np.array(names) == name
        log_lag, error = random_effects(values[chosen, 0], variances[chosen, 0])
        latency, _ = random_effects(values[chosen, 2], variances[chosen, 2])
        moments[name] = float(np.log(np.exp(log_lag) + max(latency, 0.0))), error**2 + LIKE**2
    return moments
