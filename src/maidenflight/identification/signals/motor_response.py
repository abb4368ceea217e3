"""The motors' lag and latency from rotor speed, accelerometer and gyro, without a simulation.

Each signal is regressed on what commands make of it through a first-order lag and a delay, on a
grid of both, with an autoregression over a quarter of a second as noise (`prediction_errors`).
Steps are of about 10 ms whatever the log's rate, commands are used at the full rate.

- **Rotor speed**, where it was measured, follows the command itself.
- The **accelerometer** along z is the thrust, and drag against climbing: without the drag the
  thrust's slow part looks too small, and with it the lag too short. Thrust per command is that
  which hovering takes, to 5 %, unless the flight contradicts it by more than `CONTRADICTION`: then
  logged commands are not what the motors got (samples of a faster, noisy loop), and it is free.
- The **gyro** hears the torques, the flapping moment and damping of its own rate. A controller
  answers it within milliseconds, so that whatever the model lacks moves the lag; it counts little.
  Where a log has only samples of the commands it does not count: the mean of two samples holds the
  answer to the noise that it is to predict.

Flights differ more than each one's noise says. Their estimates are joined as random effects, and
half of what accelerometer and gyro, each by itself and in full, disagree by is added to the
interval, which allows for `BETWEEN` at least.

Measured on logs of a brushed Crazyflie with known rotor speeds, where the likelihood of one row
ahead found half the lag; docs/identification.md has the figures.

Source: Eschmann, Albani and Loianno 2024 (accelerometer against commands); DerSimonian and Laird
1986 (random effects); Miller and Dunson 2019, Robust Bayesian inference via coarsening (powers of
likelihoods).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from maidenflight.flights.log import Flight, by_log
from maidenflight.identification.signals.flight_signals import (
    body_velocity,
    force_along_z,
    gyro,
    lagged,
    means,
    stride,
)
from maidenflight.identification.signals.regression import (
    MEMORY,
    Prior,
    Products,
    products,
    regress,
)
from maidenflight.parameters import Parameters, levers

LAGS = np.geomspace(0.010, 0.25, 18)
"""Lags that are tried [s]."""
SEEN_LAGS = (float(LAGS[1]), float(LAGS[-2]))
"""Lags within which neighbours on both sides were tried [s]."""
LATENCIES = np.array([0.0, 0.004, 0.008, 0.012])
"""Latencies that are tried [s]."""
FEWEST = 300
"""Steps that a flight must have to be looked at."""
HOVER = 0.05
"""Standard deviation of thrust per command about that of hovering, as a share."""
CONTRADICTION = 8.0
"""Log-likelihood gain of a free thrust per command beyond which hovering does not hold it
[nats]."""
BETWEEN = 0.1
"""Least standard deviation between flights of one drone that the interval allows for, as a share:
one flight, or some that agree by chance, do not show what they differ by."""
WEIGHTS = {"rotor speed": 0.1, "accelerometer": 1.0, "gyro x": 0.03, "gyro y": 0.03}
"""Power to which each signal's likelihood is taken."""
_SEGMENT = 256
"""Steps of a segment of a spectrum."""
DRAWS = 500
"""Samples of the posterior."""
_GYRO: tuple[str, ...] = ("gyro x", "gyro y")
"""Signals that hear the motors' torque about an axis."""


class Look(NamedTuple):
    """Lag and latency together as one signal shows them [s]."""

    signal: str
    value: float
    interval: tuple[float, float]
    """95 %."""


@dataclass(frozen=True)
class MotorResponse:
    """What logs show of the motors."""

    lag: Float[np.ndarray, "N"]
    """Samples of the posterior [s]."""
    latency: Float[np.ndarray, "N"]
    """Likewise."""
    spread: float
    """Standard deviation of lag and latency together between flights [s]."""
    looks: tuple[Look, ...]
    notes: tuple[str, ...]
    per_flight: Mapping[str, tuple[float, float]]
    """Mean and variance of the logarithm of lag and latency together [s], by flight."""


class _Seen(NamedTuple):
    """One signal of one flight on the grid."""

    losses: Float[np.ndarray, "T D"]
    coefficients: Float[np.ndarray, "T D k"]
    free: bool = False


def motor_response(
    flights: Sequence[Flight],
    generator: np.random.Generator,
    drone: Parameters,
    on_flight: Callable[[int, int], None] | None = None,
) -> MotorResponse | None:
    """What flights show of the motors; None where no signal but the estimated state shows it.

    Args:
        flights: checked flights of one rate.
        generator: random numbers for the samples.
        drone: where its rotors are.
        on_flight: called with (flights looked at, flights).
    """
    groups, found = by_log(flights), {}
    for number, (name, parts) in enumerate(groups.items(), 1):
        if seen := _seen(parts, _torques(drone)):
            found[name] = seen
        if on_flight is not None:
            on_flight(number, len(groups))
    if not found:
        return None
    free = [name for name, seen in found.items() if any(one.free for one in seen.values())]
    if len(free) < len(found):
        found = {name: seen for name, seen in found.items() if name not in free}
    losses = {name: _joint(seen) for name, seen in found.items()}
    per_flight = {name: _log_total(loss) for name, loss in losses.items()}
    mean, error, spread = _random_effects(list(per_flight.values()))
    looks = tuple(_look(signal, found) for signal in WEIGHTS if _has(signal, found))
    apart = _disagreement(looks)
    reach = np.linalg.norm([error, max(spread, BETWEEN), apart])
    total = np.exp(mean + generator.normal(size=DRAWS) * reach)
    pooled = np.sum(list(losses.values()), axis=0) / np.sqrt(len(losses))
    latency = np.minimum(_latencies(pooled, generator), total - LAGS[0] / 2)
    notes = [
        f"{name}: commands do not explain the thrust that hovering takes; they are samples of "
        "what the "
        "motors got, and its lag is used only where no other flight tells it"
        for name in free
    ]
    lag = np.maximum(total - np.maximum(latency, 0.0), LAGS[0] / 2)
    return MotorResponse(
        lag, np.maximum(latency, 0.0), float(np.exp(mean) * spread), looks, tuple(notes), per_flight
    )


def _has(signal: str, found: dict[str, dict[str, _Seen]]) -> bool:
    return any(signal in seen for seen in found.values())


class _Prepared(NamedTuple):
    """One piece of flight, and what of it does not depend on the motors; N rows, M steps."""

    period: float
    rows: int
    """Rows of a step."""
    command: Float[np.ndarray, "N 4"]
    """sqrt(u), held until the next row."""
    signals: dict[str, Float[np.ndarray, "M c"]]
    beside: dict[str, Float[np.ndarray, "M k"]]
    """What explains each signal besides the motors."""
    weights: dict[str, Float[np.ndarray, "4"]]
    """Of the motors' thrusts in each signal of the gyro."""


def _torques(drone: Parameters) -> Float[np.ndarray, "4 2"]:
    """Torque of each rotor's thrust about x and y, as shares of the largest about the axis."""
    turned = levers(drone)[:, :2]
    return turned / np.abs(turned).max(axis=0)


def _prepared(flight: Flight, torques: Float[np.ndarray, "4 2"]) -> _Prepared:
    rows, signals, beside = stride(flight), {}, {}
    count = len(flight) // rows
    velocity = means(body_velocity(flight), rows)
    if flight.rotor_speed is not None:
        signals["rotor speed"] = means(flight.rotor_speed.astype(float), rows)
        beside["rotor speed"] = np.ones((count, 1))
    elif flight.accelerometer is not None:
        signals["accelerometer"] = means(force_along_z(flight)[:, None], rows)
        beside["accelerometer"] = _constant_and(velocity[:, [2]])
        if flight.zero_order_hold:
            rates = gyro(flight)[: count * rows : rows]
            turns = np.diff(rates, axis=0) / (rows * flight.period)
            for axis, name in enumerate(_GYRO):
                signals[name] = turns[:, [axis]]
                across = velocity[:-1, [1 - axis]]
                beside[name] = _constant_and(across, rates[:-1, [axis]])
    weights = dict(zip(_GYRO, torques.T, strict=True))
    return _Prepared(flight.period, rows, flight.speed_command, signals, beside, weights)


def _constant_and(*columns: Float[np.ndarray, "M 1"]) -> Float[np.ndarray, "M k"]:
    """A constant, and columns that say something."""
    kept = [column for column in columns if column.any()]
    return np.concatenate([np.ones_like(columns[0]), *kept], axis=1)


def _seen(parts: Sequence[Flight], torques: Float[np.ndarray, "4 2"]) -> dict[str, _Seen]:
    """Signals of one flight's pieces on the grid."""
    prepared = [_prepared(part, torques) for part in parts if len(part) // stride(part) >= FEWEST]
    if not prepared or not prepared[0].signals:
        return {}
    made: dict[str, list[list[Products]]] = {signal: [] for signal in prepared[0].signals}
    for lag in LAGS:
        for latency in LATENCIES:
            speeds = [lagged(part.command, part.period, lag, latency) for part in prepared]
            for signal, columns in made.items():
                columns.append(_columns(prepared, speeds, signal))
    found = {signal: _on_grid(columns) for signal, columns in made.items()}
    if columns := made.get("accelerometer"):
        held, loose = _on_grid(columns, _hover), found["accelerometer"]
        contradicted = held.losses.min() - loose.losses.min() > CONTRADICTION
        found["accelerometer"] = loose._replace(free=True) if contradicted else held
    # A torque that turns the drone the wrong way is no torque.
    return {
        signal: one for signal, one in found.items() if _best(one)[0] > 0 or signal not in _GYRO
    }


def _on_grid(
    columns: Sequence[Sequence[Products]], known: Callable[[Products], Prior] | None = None
) -> _Seen:
    """From the products of a signal's columns at each grid point, latencies running fastest."""
    shape = (len(LAGS), len(LATENCIES))
    fits = [
        regress(column, [known(one) if known else None for one in column])
        for column in zip(*columns, strict=True)
    ]
    losses = np.sum([[fit.loss for fit in column] for column in fits], axis=0)
    coefficients = np.array([fit.coefficients for fit in fits[0]])
    return _Seen(losses.reshape(shape), coefficients.reshape(*shape, -1))


def _hover(products: Products) -> Prior:
    """Thrust per command that hovering takes: the ratio of both signals' sums."""
    constant = 2
    force, thrust = products.late[0, 0, :2, constant]
    return Prior(0, force / thrust, HOVER * force / thrust)


def _best(seen: _Seen) -> Float[np.ndarray, "k"]:
    return seen.coefficients[np.unravel_index(np.argmin(seen.losses), seen.losses.shape)]


def _columns(
    prepared: Sequence[_Prepared], speeds: Sequence[Float[np.ndarray, "N+1 4"]], signal: str
) -> list[Products]:
    """Products of each column of a signal with what the motors add to it, and what is beside."""
    order = max(1, round(MEMORY / (prepared[0].rows * prepared[0].period)))
    moved = [_of_motors(part, speed, signal) for part, speed in zip(prepared, speeds, strict=True)]
    return [
        products(
            [part.signals[signal][:, column] for part in prepared],
            [
                np.column_stack([motors[:, column], part.beside[signal]])
                for part, motors in zip(prepared, moved, strict=True)
            ],
            order,
        )
        for column in range(prepared[0].signals[signal].shape[1])
    ]


def _of_motors(
    part: _Prepared, speed: Float[np.ndarray, "N+1 4"], signal: str
) -> Float[np.ndarray, "M c"]:
    """What the motors add to each column of a signal, in steps."""
    if signal == "rotor speed":
        return means(0.5 * (speed[1:] + speed[:-1]), part.rows)
    combined = (speed**2) @ part.weights.get(signal, np.ones(4))
    steps = means((0.5 * (combined[1:] + combined[:-1]))[:, None], part.rows)
    return steps[: len(part.signals[signal])]


def cross_spectrum(flights: Sequence[Flight], drone: Parameters) -> list[Look]:
    """Lag and latency by the phase between torque command and angular acceleration, 1 to 10 Hz.

    It takes feedback for response: a look that is independent of every model, not a better one.

    Args:
        flights: of one rate.
        drone: where its rotors are.

    Source: Bendat and Piersol 2010, Random data, sec. 9.2 (error of a phase from the coherence).
    """
    losses = np.zeros((len(LAGS), len(LATENCIES)))
    for axis, weights in enumerate(_torques(drone).T):
        pairs = [_torque_and_turn(flight, axis, weights) for flight in flights]
        pairs = [pair for pair in pairs if len(pair[0]) >= 2 * _SEGMENT]
        if not pairs:
            return []
        step = stride(flights[0]) * flights[0].period
        frequencies, cross = _spectrum(pairs, step)
        driving = np.abs(_spectrum([(torque, torque) for torque, _ in pairs], step)[1])
        driven = np.abs(_spectrum([(turn, turn) for _, turn in pairs], step)[1])
        coherence = np.clip(np.abs(cross) ** 2 / (driving * driven + 1e-30), 0.0, 0.99)
        looks = sum(len(torque) for torque, _ in pairs) / (_SEGMENT / 2)
        band = (frequencies > 1.0) & (frequencies < 10.0)
        around = 2 * np.pi * frequencies[band]
        expected = -np.arctan(around * LAGS[:, None, None]) - around * LATENCIES[None, :, None]
        weight = 2 * looks * coherence[band] / (1 - coherence[band])
        losses += np.sum(weight * (1 - np.cos(np.angle(cross[band]) - expected)), axis=2)
    mean, variance = _log_total(losses)
    value, low, high = np.exp(mean + 1.96 * np.sqrt(variance) * np.array([0.0, -1.0, 1.0]))
    return [Look("cross-spectrum", float(value), (float(low), float(high)))]


def _torque_and_turn(
    flight: Flight, axis: int, weights: Float[np.ndarray, "4"]
) -> tuple[np.ndarray, np.ndarray]:
    """Torque command and angular acceleration of one axis in steps, as far as scale."""
    rows = stride(flight)
    rates = means(flight.body_rates.astype(float), rows)[:, axis]
    torque = means((flight.mean_command @ weights)[:, None].astype(float), rows)[:, 0]
    return torque, np.gradient(rates, rows * flight.period) if len(rates) > 1 else rates


def _spectrum(
    pairs: Sequence[tuple[np.ndarray, np.ndarray]], step: float
) -> tuple[Float[np.ndarray, "F"], np.ndarray]:
    """Cross-spectrum of pairs of signals, longer ones counting more."""
    found = [scipy.signal.csd(one, other, 1 / step, nperseg=_SEGMENT) for one, other in pairs]
    sizes = np.array([len(one) for one, _ in pairs], float)
    return found[0][0], np.einsum("i,if->f", sizes, np.stack([part for _, part in found]))


def _joint(seen: dict[str, _Seen]) -> Float[np.ndarray, "T D"]:
    return np.sum([WEIGHTS[name] * one.losses for name, one in seen.items()], axis=0)


def _weights(losses: Float[np.ndarray, "T D"]) -> Float[np.ndarray, "T D"]:
    found = np.exp(losses.min() - losses)
    return found / found.sum()


def _log_total(losses: Float[np.ndarray, "T D"]) -> tuple[float, float]:
    """Mean and variance of the logarithm of lag and latency together; a grid point is 0.05 wide."""
    weights, total = _weights(losses), np.log(LAGS[:, None] + LATENCIES[None])
    mean = float(np.sum(weights * total))
    return mean, float(np.sum(weights * (total - mean) ** 2)) + 0.05**2


def _random_effects(found: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
    """Mean of estimates that differ by more than their variances, its error, and by how much.

    Source: DerSimonian and Laird 1986, Meta-analysis in clinical trials.
    """
    values, variances = np.array(found).T
    weights = 1 / variances
    mean = weights @ values / weights.sum()
    excess = weights @ (values - mean) ** 2 - (len(values) - 1)
    scale = weights.sum() - (weights @ weights) / weights.sum()
    between = max(0.0, float(excess / scale)) if len(values) > 1 else 0.0
    weights = 1 / (variances + between)
    return (
        float(weights @ values / weights.sum()),
        float(1 / np.sqrt(weights.sum())),
        float(np.sqrt(between)),
    )


def _look(signal: str, found: dict[str, dict[str, _Seen]]) -> Look:
    """What a signal says by itself, its likelihood taken in full.

    Under the weights that are small the looks of sound flights differ by chance only.
    """
    parts = [seen[signal].losses for seen in found.values() if signal in seen]
    mean, error, spread = _random_effects([_log_total(part) for part in parts])
    reach = 1.96 * np.hypot(error, spread)
    value, low, high = np.exp([mean, mean - reach, mean + reach])
    return Look(signal, float(value), (float(low), float(high)))


def _disagreement(looks: Sequence[Look]) -> float:
    """Half of what the looks differ by, as a share."""
    values = np.log([look.value for look in looks])
    return float(np.ptp(values)) / 2 if len(values) > 1 else 0.0


def _latencies(losses: Float[np.ndarray, "T D"], generator: np.random.Generator) -> np.ndarray:
    """Samples of the latency, with a density that is linear between grid points."""
    weights = _weights(losses).sum(axis=0)
    step = LATENCIES[1] - LATENCIES[0]
    chosen = generator.choice(LATENCIES, DRAWS, p=weights)
    return np.maximum(chosen + generator.triangular(-step, 0.0, step, DRAWS), 0.0)
