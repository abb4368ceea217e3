"""The motors' lag and latency from gyro and commands.

Each stretch of flight tells, by roll and by pitch, which lag goes with which latency
(`loop_spectra`); stretches are joined as random effects for each latency. docs/identification.md
leads from there to the interval and has figures of drones whose rotor speeds were measured.

The accelerometer is not used: of four motors together it hears drag, vibration and loads too,
and from log to log of one brushed drone says 60 to 118 ms where rotor speeds say 80. Samples of a
faster loop hold noise from above half the log's rate; where it is as strong as what they hold of a
few hertz, they are left out. Measured speeds show more; see `likelihood.speed_errors`.

Source: DerSimonian and Laird 1986 (random effects); Miller and Dunson 2019, Robust Bayesian
inference via coarsening (powers of likelihoods).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from maidenflight.flights.log import GYRO_DELAY, Flight, by_log
from maidenflight.identification.signals.flight_signals import is_zero_order_hold
from maidenflight.identification.signals.loop_spectra import REACH, LagByDelay, lag_by_delay
from maidenflight.identification.signals.spectra import Spectra, spectra
from maidenflight.identification.uncertainty import RESAMPLES, Evidence
from maidenflight.parameters import Parameters, levers

LATENCIES = 1e-3 * np.arange(-4.0, 20.01, 0.25)
"""Latencies that are tried [s]; below zero are differences of time stamps. 0.7 and 1.4 times as
far, ends of inertia move by 0.5 and 0.4 of half an interval (paper/identification/constants.py)."""
LAG_BOUNDS = (0.01, 0.25)
"""Lags that these signals show [s]: 0.7 and 1.4 times as long no lag moves, but from 14 ms on that
of `better_tune`, which is shorter, passes for clear (paper/identification/constants.py)."""
USUAL, USUAL_DEVIATION = 0.002, 0.0014
"""Latency of commands on board and its standard deviation [s]: within a period of loop and of ESC,
2 ms +- 1 ms, and as much again for the gyro's own filter (`other_ways.FILTER`)."""
DELAY_ERROR = 3.6e-4
"""Standard error with which any lag and latency are known [s]: a gyro's filter of 2.8 ms, which
passes for latency, makes a lag of 30 ms 0.3 ms longer, and motors that slow down 2.4 times as
slowly answer 0.2 ms before one of their equivalent lag (paper/notes/identification.md)."""
_UNKNOWN_FILTER = GYRO_DELAY / np.sqrt(3.0)
"""Standard error of a gyro's delay that no log tells [s]: from none to twice a Crazyflie's."""
_UNUSUAL = 0.03
"""Share of drones of which nothing of the kind is known: with 0.021 an end of an inertia moves by
0.23 of half its interval, with 0.042 by less (paper/identification/constants.py)."""
SHORTEST, _LONGEST, _MOST = 3.0, 10.0, 16
"""Length of a stretch at least and at most [s], and stretches beyond which they are longer. In one
of 20 s for two of 10 s NanoBench's inertia moves by 2.2 of half its interval
(paper/identification/constants.py; against measured speeds `truth_board.py --lag`)."""
_CLEAR, QUICK = 5.0, 0.0051
"""How much stronger than what their samples fold commands must be, in rows beyond that period [s]:
quicker ones fold from above 180 Hz, behind the filters of any rate controller. Harmless within a
factor of 1.4 (paper/identification/constants.py)."""
_COHERENT = 0.5
"""Coherence of sampled commands and angular acceleration below which they are hardly one loop's: of
NanoBench's and the authors' logs at 100 Hz all stretches have 0.63 and more, of NanoDrone's, whose
clocks drift, 0.13 to 0.4; measured with `QUICK`."""
LIKE, OWN = 0.05, 0.03
"""Least errors of the joined lag and of a stretch's, shares: no motor is quite of first order.
Three drones' are 5 % off at most (paper/notes/identification.md#measured-rotor-speeds)."""
_NARROWER = 0.7
"""Share of the usual interval's width that a latency's must be below to be told; measured with
`QUICK`."""
_FEW = 4
"""Loops that are looked at before, a share of a second each; chosen."""
_GYRO = {"gyro x": "inertia_x", "gyro y": "inertia_y"}
LATENCY_OF_SPEEDS = 4e-4
"""Standard deviation of the latency where speeds are measured [s]: 0.3 to 0.5 ms in three folders
(paper/notes/identification.md)."""
TWICE, SPEEDS = "fly as long again", "log rotor speeds"
"""What narrows the lag."""


@dataclass(frozen=True)
class MotorResponse:
    """What logs show of the motors."""

    lag: Float[np.ndarray, "N"]
    """Samples of the posterior [s]."""
    latency: Float[np.ndarray, "N"]
    """Likewise."""
    usual_latency: tuple[float, float] | None
    """What 95 % of latencies are before and after these flights [s], if they do not narrow it."""
    evidence: tuple[Evidence, ...]
    """What each signal says of lag and latency together [s]."""
    notes: tuple[str, ...]
    per_flight: Mapping[str, tuple[float, float]]
    """Mean and variance of the logarithm of lag and latency together [s], by flight."""
    expected_deviations: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Standard deviations to expect of that logarithm and of the latency [s], by what is done
    next."""
    inertia_per_thrust: Mapping[str, Float[np.ndarray, "N"]] = field(default_factory=dict)
    """Samples of inertia over thrust-to-weight ratio [kg m2], each with one of the lag, by
    parameter; none where no gyro tells it."""
    spin_down_ratio: Float[np.ndarray, "N"] | None = None
    """Samples of the lag slowing down over that speeding up; None where nothing shows it."""

    @property
    def is_identifiable(self) -> bool:
        """Whether these flights tell the lag: within a factor of two up and down."""
        return is_clear(self.lag + self.latency)


def is_clear(samples: Float[np.ndarray, "N"]) -> bool:
    """Returns whether 95 % of samples lie within a factor of two up and down."""
    return bool(np.std(np.log(samples)) < np.log(2) / 1.96)


class _Stretch(NamedTuple):
    """What one signal shows over one stretch."""

    flight: str
    signal: str
    profile: LagByDelay


class _Joined(NamedTuple):
    """What stretches say together, for each of D latencies."""

    weight: Float[np.ndarray, "D"]
    log_total: Float[np.ndarray, "D"]
    """Mean of the logarithm of lag and latency together [s]."""
    error: Float[np.ndarray, "D"]

    @property
    def moments(self) -> tuple[float, float]:
        """Mean and variance of the logarithm of lag and latency together [s]."""
        mean = float(self.weight @ self.log_total)
        return mean, float(self.weight @ ((self.log_total - mean) ** 2 + self.error**2))

    def delay_evidence(self, signal: str) -> Evidence:
        """Returns what a signal says by itself."""
        mean, variance = self.moments
        value, low, high = np.exp(mean + 1.96 * np.sqrt(variance) * np.array([0.0, -1.0, 1.0]))
        return Evidence(signal, float(value), (float(low), float(high)))

    def draw(
        self, generator: np.random.Generator
    ) -> tuple[Int[np.ndarray, "N"], Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
        """Returns samples of places in `LATENCIES`, and of lag and latency [s]."""
        indices = generator.choice(len(self.weight), RESAMPLES, p=self.weight)
        total = self.log_total[indices] + self.error[indices] * generator.normal(size=RESAMPLES)
        jitter = DELAY_ERROR * generator.normal(size=RESAMPLES)
        latency = np.maximum(LATENCIES[indices] + jitter, 0.0)
        lag = np.maximum(np.exp(total) - latency, LAG_BOUNDS[0] / 2)
        return indices, lag, latency


def estimate_motor_response(
    flights: Sequence[Flight],
    generator: np.random.Generator,
    drone: Parameters,
    on_flight: Callable[[int, int], None] | None = None,
) -> MotorResponse | None:
    """Returns what flights show of the motors; None where they are too short or show nothing.

    None too of flights whose commands act from row to row, without an accelerometer: a policy at
    the log's rate, which the likelihood of one row ahead models exactly.

    Args:
        flights: checked flights of one rate.
        generator: random numbers for the samples.
        drone: where its rotors are.
        on_flight: called with (flights looked at, flights).
    """
    if all(flight.zero_order_hold and flight.accelerometer is None for flight in flights):
        return None
    groups, stretches = by_log(flights), list[_Stretch]()
    longest = max(_LONGEST, sum(flight.duration for flight in flights) / _MOST)
    for number, parts in enumerate(groups.values(), 1):
        for part in parts:
            stretches += _stretches(part, drone, longest)
        if on_flight is not None:
            on_flight(number, len(groups))
    if not stretches:
        return None
    before = _before(flights)
    joined = _joined(stretches, before)
    indices, lag, latency = joined.draw(generator)
    if not all(flight.gyro_delay_known for flight in flights):
        # What the filter delays passes for latency.
        latency = np.maximum(latency + _UNKNOWN_FILTER * generator.normal(size=RESAMPLES), 0.0)
    names = dict.fromkeys(stretch.flight for stretch in stretches)
    left_out = [name for name in groups if name not in names]
    note = (
        f"{', '.join(left_out)}: too short, or commands and motion do not show the motors' lag; "
        "that of the other flights is taken"
    )

    def joined_by(field: str, value: str) -> _Joined:
        return _joined(
            [stretch for stretch in stretches if getattr(stretch, field) == value], before
        )

    signals = dict.fromkeys(stretch.signal for stretch in stretches)
    return MotorResponse(
        lag,
        latency,
        usual_latency(flights, latency),
        tuple(joined_by("signal", signal).delay_evidence(signal) for signal in signals),
        (note,) if left_out else (),
        {name: joined_by("flight", name).moments for name in names},
        _expect(joined, stretches, latency),
        {
            name: _inertia_per_thrust(
                [stretch for stretch in stretches if stretch.signal == signal],
                indices,
                lag,
                generator,
            )
            * float(drone.mass * drone.gravity / 4 * np.abs(levers(drone)[:, axis]).max())
            for axis, (signal, name) in enumerate(_GYRO.items())
            if signal in signals
        },
    )


def _inertia_per_thrust(
    stretches: Sequence[_Stretch],
    draws: Int[np.ndarray, "N"],
    lag: Float[np.ndarray, "N"],
    generator: np.random.Generator,
) -> Float[np.ndarray, "N"]:
    """Returns samples of a command over the angular acceleration that it leads to.

    Stretches are joined at one lag: which has too much of that has too much of the gain too.
    """
    samples, log_lag = np.ones(len(lag)), np.log(lag)
    profiles = [stretch.profile for stretch in stretches]
    for index in np.unique(draws):
        here = [profile for profile in profiles if np.isfinite(profile.loss[index])] or profiles
        columns = [
            (profile.log_gain, profile.gain_slope, profile.log_lag, profile.deviation)
            for profile in here
        ]
        gain, slope, own_lag, deviation = np.array(columns)[:, :, index].T
        chosen = draws == index
        middle = float(np.mean(log_lag[chosen]))
        joined, error = random_effects(
            gain + slope * (middle - own_lag), np.hypot(deviation, OWN) ** 2
        )
        moved = np.mean(slope) * (log_lag[chosen] - middle)
        noise = np.hypot(error, LIKE) * generator.normal(size=chosen.sum())
        samples[chosen] = np.exp(-(joined + moved + noise))
    return samples


def _expect(
    joined: _Joined, stretches: Sequence[_Stretch], latency: Float[np.ndarray, "N"]
) -> dict[str, tuple[float, float]]:
    """Returns the standard deviations of lag and latency together, and of latency, to expect.

    From twice the flight the variance of joined stretches is halved, from measured speeds each
    stretch has the least error; `LIKE` stays.
    """
    own = float(joined.weight @ (joined.error**2 - LIKE**2))
    expected = {TWICE: (float(np.sqrt(joined.moments[1] - own / 2)), float(np.std(latency)))}
    error = float(np.hypot(LIKE, OWN / np.sqrt(len(stretches) / len(_GYRO))))
    return expected | {SPEEDS: (error, LATENCY_OF_SPEEDS)}


def _before(
    flights: Sequence[Flight], latencies: Float[np.ndarray, "D"] = LATENCIES
) -> Float[np.ndarray, "D"]:
    """How plausible latencies are without a flight.

    Mostly as `USUAL`, but logs of samples may have read commands a row apart from the gyro.
    """
    zero_order_hold = is_zero_order_hold(flights)
    size = np.hypot(
        USUAL_DEVIATION, 0.0 if zero_order_hold else min(flights[0].period, 0.01) / np.sqrt(12)
    )
    wide = np.gradient(latencies)
    near = np.exp(-0.5 * ((latencies - USUAL) / size) ** 2) * wide
    return (1 - _UNUSUAL) * near / max(near.sum(), 1e-12) + _UNUSUAL * wide / wide.sum()


def usual_latency(
    flights: Sequence[Flight], latency: Float[np.ndarray, "N"]
) -> tuple[float, float] | None:
    """Returns where latencies may lie [s], if samples of the posterior say no more than is usual.

    Nor do they where time stamps of commands and gyro may differ.
    """
    before = _before(flights)
    low, high = np.interp([0.025, 0.975], np.cumsum(before), np.maximum(LATENCIES, 0.0))
    least, most = np.quantile(latency, [0.025, 0.975])
    narrower = most - least < _NARROWER * (high - low)
    if narrower and is_zero_order_hold(flights):
        return None
    return float(min(low, least)), float(max(high, most))


class LoopLatency(NamedTuple):
    """What some loops of commands and gyro say of the latency."""

    weight: Float[np.ndarray, "D"]
    """Of each of `LATENCIES`; zeros where no loop has one of them."""
    loops: int
    """Looked at."""


def latency_of_loop(flights: Sequence[Flight], drone: Parameters, rows: int = 0) -> LoopLatency:
    """Returns what `_FEW` loops of commands and gyro say of the latency.

    Args:
        flights: of one rate.
        drone: where its rotors are.
        rows: by which their commands were moved to be earlier.
    """
    longest = max(_LONGEST, sum(flight.duration for flight in flights) / _MOST)
    pieces = sorted(flights, key=lambda flight: flight.duration, reverse=True)
    every = (loop for piece in pieces for loop in _loops_of_parts(piece, drone, longest))
    loops = list(islice(every, _FEW))
    stretches = [found for loop in loops if (found := _look(*loop)) is not None]
    if not stretches:
        return LoopLatency(np.zeros(len(LATENCIES)), len(loops))
    before = _before(flights, LATENCIES - rows * flights[0].period)
    return LoopLatency(_joined(stretches, before).weight, len(loops))


def _stretches(flight: Flight, drone: Parameters, longest: float) -> Iterator[_Stretch]:
    """What each signal shows over parts of a piece of flight."""
    every = (_look(*loop) for loop in _loops_of_parts(flight, drone, longest))
    yield from (stretch for stretch in every if stretch is not None)


def _look(part: Flight, signal: str, loop: Spectra) -> _Stretch | None:
    """What one signal shows over a part of a flight."""
    profile = lag_by_delay(loop, LATENCIES + part.gyro_delay)
    return None if profile is None else _Stretch(part.name, signal, profile)


def _loops_of_parts(
    flight: Flight, drone: Parameters, longest: float
) -> Iterator[tuple[Flight, str, Spectra]]:
    """Yields parts of a piece of flight, and what may show the lag there."""
    zero_order_hold, parts = flight.zero_order_hold, max(1, round(flight.duration / longest))
    ends = np.linspace(0, len(flight), parts + 1).astype(int)
    for begin, end in zip(ends[:-1], ends[1:], strict=True):
        part = flight.part(begin, end)
        if len(part) * part.period < SHORTEST:
            continue
        for signal, loop in _loops(part, drone):
            clear = loop.clear > _CLEAR and loop.coherence > _COHERENT
            if zero_order_hold or part.period <= QUICK or clear:
                yield part, signal, loop


def _loops(flight: Flight, drone: Parameters) -> Iterator[tuple[str, Spectra]]:
    """Name and spectra, with the commands, of each axis of the gyro."""
    turned = levers(drone)[:, :2]
    torque = flight.command.astype(float) @ (turned / np.abs(turned).max(axis=0))
    rates, hold = flight.body_rates.astype(float), flight.zero_order_hold
    for axis, signal in enumerate(_GYRO):
        pair = torque[:, [axis]], rates[:, [axis]]
        yield signal, spectra(*pair, flight.period, zero_order_hold=hold, differentiate=True)


def _joined(stretches: Sequence[_Stretch], before: Float[np.ndarray, "D"]) -> _Joined:
    """Joins stretches for each latency that any of them allows.

    Whatever the model lacks is common to the stretches of one drone, so that their likelihoods of
    the latency are taken to the power of one over the root of their number.
    """
    profiles = [stretch.profile for stretch in stretches]
    loss = np.minimum([profile.loss for profile in profiles], REACH).sum(axis=0)
    weight = np.log(before) - loss / np.sqrt(len(stretches))
    weight = np.exp(weight - weight.max())
    mean, error = np.zeros((2, len(LATENCIES)))
    for index, latency in enumerate(LATENCIES):
        here = [profile for profile in profiles if np.isfinite(profile.loss[index])]
        if not here:
            weight[index] = 0.0
            continue
        lag = np.exp([profile.log_lag[index] for profile in here])
        total = np.maximum(lag + latency, LAG_BOUNDS[0] / 2)
        errors = np.hypot([profile.deviation[index] for profile in here] * lag / total, OWN)
        mean[index], error[index] = random_effects(np.log(total), errors**2)
    return _Joined(weight / weight.sum(), mean, np.hypot(error, LIKE))


def random_effects(
    values: Float[np.ndarray, "n"], variances: Float[np.ndarray, "n"]
) -> tuple[float, float]:
    """Returns the mean of estimates that may differ by more than their variances, and its error.

    Source: DerSimonian and Laird 1986, Meta-analysis in clinical trials.
    """
    weights = 1 / variances
    mean = weights @ values / weights.sum()
    excess = weights @ (values - mean) ** 2 - (len(values) - 1)
    scale = weights.sum() - (weights @ weights) / weights.sum()
    between = max(0.0, float(excess / scale)) if len(values) > 1 else 0.0
    weights = 1 / (variances + between)
    return float(weights @ values / weights.sum()), float(1 / np.sqrt(weights.sum()))
