"""The lag between a command and what follows it, from their spectra in a loop that is closed.

Most of a Crazyflie's torque commands are answers to noise: a regression of the motion on them
finds a mixture of the drone and of the controller's inverse. Both equations are therefore fitted
together, with set-points r and disturbances e of any size in each band of frequencies:

    y = G u + e,   u = r - H y,   G = gain exp(-s delay) / (1 + s lag)

y is the angular acceleration, u the torque command, and H y what a PID or Lee controller makes of
rate, attitude, its integral and the angular acceleration, with weights that are not negative.
Minus the log likelihood is the sum over bands of

    n [log mean |y - G u|^2 + log mean |u + H y|^2 - 2 mean log |1 + G H|]

whose last term, the Jacobian of (e, r) by (y, u), regressions of filtered signals lack. A loop that
the model makes unstable is no solution: it is not what flew.

Source: Whittle 1953 (likelihood of spectra); Ljung 1999, System identification, sec. 13.5, and
Forssell and Ljung 1999, Closed-loop identification revisited (joint input-output methods).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float
from numpy.polynomial import polynomial

from maidenflight.identification.signals.spectra import HIGHEST, LOWEST, Spectra
from maidenflight.identification.unknowns import UNKNOWNS

_POWERS = (0, -1, -2, 1)
"""Powers of s by which a controller acts on the rate."""
_CENTRE = 2 * np.pi * np.sqrt(LOWEST * HIGHEST)
"""Frequency at which the weights of all powers are in like units [rad/s]."""
_ANSWER = 0.002
"""Delay from a measurement to the answer of an on-board controller, and its deviation [s]: with 2.8
ms an end of INDIflight's inertia moves by 0.23 of half its interval
(paper/identification/constants.py)."""
_STEP = 0.2
"""Change of the logarithm of the lag by which the curvature is measured."""
_STARTS = (0.03, 0.07)
"""Lags from which an optimum is looked for [s]. It and when a search ends are harmless within a
factor of 1.4 (paper/identification/constants.py)."""
_SEARCH = {"gtol": 2e-2, "maxiter": 40}
"""When a search for an optimum ends [nats a unit of the parameters]; measured with `_STARTS`."""
_NODES = 1e-3 * np.array([0.0, 2.0, 4.0, 5.0, 6.0, 7.0, 8.5, 10.0, 12.0, 14.0, 16.0, 19.0, 24.0])
"""Delays over the least one that are tried [s]: 0.7 times as far apart no end moves by more than a
tenth of half an interval, 1.4 times by 0.54 (paper/identification/constants.py)."""
_GROWTH = 0.04
"""Damping ratio below zero down to which an oscillation may be a limit cycle; with 0 good fits are
refused (paper/notes/identification.md#attempts)."""
REACH = 10.0
"""Loss over the least one beyond which further delays are not tried, and most by which one stretch
may vote against a latency [nats]: chance has it once in 130,000 times. Source: Wilks 1938,
chi-square of one parameter."""


class LagByDelay(NamedTuple):
    """What spectra say of the lag for each of D delays."""

    loss: Float[np.ndarray, "D"]
    """Over the least one [nats]; infinite where there is no solution."""
    log_lag: Float[np.ndarray, "D"]
    """Logarithm of the best lag [s]."""
    deviation: Float[np.ndarray, "D"]
    """Its standard error."""
    log_gain: Float[np.ndarray, "D"]
    """Logarithm of the steady motion over the command."""
    gain_slope: Float[np.ndarray, "D"]
    """By how much that rises with the logarithm of the lag."""


class _Model:
    """The likelihood of spectra for one delay, and its slope.

    Parameters are the logarithms of lag and gain, then the roots of the
    controller's weights and its delay, in units of their usual sizes.
    """

    def __init__(self, spectra: Spectra, delay: float) -> None:
        self.spectra, self.delay = spectra, delay
        z = spectra.s / _CENTRE
        self.basis = np.stack([z ** (power - 1) for power in _POWERS])
        self.lines = np.bincount(spectra.band) * spectra.averages
        self.twice = 2 * spectra.averages
        # What no parameter changes, once: an evaluation is a hundred microseconds.
        self.delayed, self.answered = np.exp(-spectra.s * delay), -spectra.s * _ANSWER
        self.unit = 1.0

    def start(self, lag: float) -> Float[np.ndarray, "d"]:
        """Returns a loop of some lag that is stable, by least squares of either equation."""
        spectra, shape = (
            self.spectra,
            np.exp(-self.spectra.s * self.delay) / (1 + self.spectra.s * lag),
        )
        gain = np.sum(np.real(shape.conj() * spectra.cross)) / np.sum(
            np.abs(shape) ** 2 * spectra.drive
        )
        x = np.array([np.log(lag), np.log(max(gain, 0.05))])
        delayed_basis = self.basis * np.exp(-spectra.s * _ANSWER)
        matrix = np.einsum("if,jf,f->ij", delayed_basis.conj(), delayed_basis, spectra.motion).real
        ridge = 1e-9 * np.trace(matrix) * np.eye(len(matrix))
        weights = np.linalg.solve(
            matrix + ridge, -np.sum(np.real(delayed_basis * spectra.cross), axis=1)
        )
        self.unit = max(float(np.abs(weights).max()), 1e-3)
        x = np.concatenate([x, np.sqrt(np.maximum(weights / self.unit, 1e-3)), [1.0]])
        for _ in range(10):
            if self.is_stable(x):
                break
            x[1] -= 0.3
        return x

    def __call__(self, x: Float[np.ndarray, "d"]) -> tuple[float, Float[np.ndarray, "d"]]:
        """Minus the log likelihood [nats] and its slope."""
        spectra, s, lag = self.spectra, self.spectra.s, np.exp(x[0])
        cross, drive, motion, twice = spectra.cross, spectra.drive, spectra.motion, self.twice
        slower = 1 / (1 + s * lag)
        response = (np.exp(x[1]) * slower) * self.delayed
        residual = motion - 2 * _shared(response, cross) + _power(response) * drive
        disturbance = spectra.means(residual)
        value = float(self.lines @ np.log(disturbance))
        # Conjugate slope with respect to G: the value moves by Re(conj(slope) dG).
        by_response = (response * drive - cross) * (twice / disturbance)[spectra.band]
        delayed_basis = self.basis * np.exp(self.answered * x[-1])
        answer = self.unit * x[2:-1] ** 2 @ delayed_basis
        setpoint = spectra.means(
            drive + 2 * _shared(answer.conj(), cross) + _power(answer) * motion
        )
        loop = 1 + response * answer
        penalty = x[-1] - 1
        jacobian = twice * float(np.log(np.abs(loop) + 1e-12).sum())
        value += float(self.lines @ np.log(setpoint)) - jacobian + 0.5 * penalty**2
        by_answer = (cross.conj() + answer * motion) * (twice / setpoint)[spectra.band]
        inverse = twice / loop
        by_answer -= (response * inverse).conj()
        by_response -= (answer * inverse).conj()
        by_weight = (delayed_basis @ by_answer.conj()).real
        controller_slopes = [
            *(2 * self.unit * x[2:-1] * by_weight),
            np.vdot(by_answer, self.answered * answer).real + penalty,
        ]
        by_lag = np.vdot(by_response, response * slower * s).real * -lag
        return value, np.array([by_lag, np.vdot(by_response, response).real, *controller_slopes])

    def slope_by_delay(self, x: Float[np.ndarray, "d"]) -> float:
        """Returns by how much the loss rises with the delay [nats/s], the parameters fixed."""
        step = 1e-5
        later = _Model(self.spectra, self.delay + step)
        later.unit = self.unit
        return (later(x)[0] - self(x)[0]) / step

    def is_stable(self, x: Float[np.ndarray, "d"]) -> bool:
        """Tests whether no oscillation of these frequencies grows, by Pade's approximation."""
        lowest = min(_POWERS) - 1
        weights = np.zeros(max(_POWERS) - lowest)
        for weight, power in zip(self.unit * x[2:-1] ** 2, _POWERS, strict=True):
            weights[power - 1 - lowest] += weight
        d = _CENTRE * (self.delay + _ANSWER * x[-1])
        ahead, behind = np.array([1, -d / 2, d * d / 12]), np.array([1, d / 2, d * d / 12])
        motors = np.concatenate([np.zeros(-lowest), [1.0, _CENTRE * np.exp(x[0])]])
        loop = polynomial.polyadd(
            polynomial.polymul(motors, behind), np.exp(x[1]) * polynomial.polymul(weights, ahead)
        )
        roots = polynomial.polyroots(loop) * _CENTRE / (2 * np.pi)
        near = (np.abs(roots) > 1.6 * LOWEST) & (np.abs(roots) < 1.5 * HIGHEST)
        return not bool((near & (roots.real > _GROWTH * np.abs(roots))).any())

    def minimize(
        self, start: Float[np.ndarray, "d"], fixed: tuple[float, ...] = ()
    ) -> tuple[float, Float[np.ndarray, "d"]]:
        """Returns the least loss from a start on, with fixed first parameters, and its place."""

        def of_rest(rest: Float[np.ndarray, "r"]) -> tuple[float, Float[np.ndarray, "r"]]:
            value, slope = self(np.concatenate([fixed, rest]))
            return value, slope[len(fixed) :]

        with np.errstate(all="ignore"):
            optimum = scipy.optimize.minimize(
                of_rest, start[len(fixed) :], jac=True, method="BFGS", options=_SEARCH
            )
        return optimum.fun, np.concatenate([fixed, optimum.x])

    def is_valid(self, value: float, x: Float[np.ndarray, "d"]) -> bool:
        """Returns whether this is a loop that can have flown, of a lag that shows."""
        is_finite = np.isfinite(value) and np.isfinite(x).all()
        low, high, _ = UNKNOWNS["motor_time_constant"].searched
        in_range = is_finite and low < np.exp(x[0]) < high and abs(x[1]) < 4.5
        return bool(in_range and self.is_stable(x))

    def deviation(self, value: float, x: Float[np.ndarray, "d"]) -> tuple[float, float]:
        """Returns the standard error of the logarithm of the lag, from the loss of two others.

        And the slope of the gain's logarithm with it.
        """
        rises, slopes = [], []
        for change in (-_STEP, _STEP):
            perturbed = x + change * (np.arange(len(x)) == 0)
            nearby, there = self.minimize(perturbed, (perturbed[0],))
            known = np.isfinite(nearby) and np.isfinite(there).all() and self.is_stable(there)
            rises.append(max(nearby - value, 0.0) if known else REACH)
            slopes += [(there[1] - x[1]) / change] if known else []
        error = 1 / np.sqrt(2 * np.mean(rises) / _STEP**2 + 1.0)
        return float(error), float(np.clip(np.mean(slopes), 0.0, 1.0)) if slopes else 1.0


def _power(values: Any) -> Any:
    return values.real**2 + values.imag**2


def _shared(value: Any, other: Any) -> Any:
    """The real part of a value's conjugate times the other."""
    return value.real * other.real + value.imag * other.imag


def lag_by_delay(spectra: Spectra, delays: Float[np.ndarray, "D"]) -> LagByDelay | None:
    """Returns the lag for each delay; None where no loop that can fly explains the spectra.

    Args:
        spectra: spectra of a command and of what follows it.
        delays: from the command to the signal, the sensor's own included [s], over 24 ms.
    """
    if min(spectra.drive.min(), spectra.motion.min()) <= 0.0:
        return None
    nodes, starts = delays[0] + _NODES, []
    for index in (len(nodes) // 3, 2 * len(nodes) // 3):
        model = _Model(spectra, float(nodes[index]))
        for lag in _STARTS:
            value, x = model.minimize(model.start(lag))
            if model.is_valid(value, x):
                starts.append((value, index, x, model.unit))
    if not starts:
        return None
    _, first, start, unit = min(starts, key=lambda start: start[0])
    optima: dict[float, tuple[float, ...]] = {}

    def best(delay: float, x: Float[np.ndarray, "d"], wants_error: bool) -> np.ndarray | None:
        """Returns the parameters from some on; None where no loop can fly, or all fit badly."""
        model = _Model(spectra, delay)
        model.unit = unit
        value, optimum = model.minimize(x)
        least = min((optimum[0] for optimum in optima.values()), default=np.inf)
        if not model.is_valid(value, optimum) or value > least + REACH:
            return None
        # The error is smooth in the delay, and costs two searches.
        errors = model.deviation(value, optimum) if wants_error else (np.nan, np.nan)
        gain = optimum[1] + np.log(spectra.scale)
        optima[delay] = value, model.slope_by_delay(optimum), optimum[0], gain, *errors
        return optimum

    for indices in (range(first, len(nodes)), range(first - 1, -1, -1)):
        x, last = start, None
        for index in indices:
            optimum = best(float(nodes[index]), x, index % 2 == 0 or not optima)
            if optimum is None and last is not None:
                _approach(best, x, last, float(nodes[index]), float(delays[1] - delays[0]))
                break
            x, last = (x, last) if optimum is None else (optimum, float(nodes[index]))
    return _interpolated(optima, delays)


def _approach(
    best: Callable[[float, Float[np.ndarray, "d"], bool], np.ndarray | None],
    x: Float[np.ndarray, "d"],
    inside: float,
    outside: float,
    step: float,
) -> None:
    """Looks for optima up to the delay from which on no loop can fly, by halves to a step [s].

    A rate loop near its limit tells the delay by that: the next node may lie 2 ms beyond it.
    """
    while abs(outside - inside) > step:
        middle = (inside + outside) / 2
        optimum = best(middle, x, True)
        inside, outside = (inside, middle) if optimum is None else (middle, outside)
        x = x if optimum is None else optimum


def _interpolated(
    optima: dict[float, tuple[float, ...]], delays: Float[np.ndarray, "D"]
) -> LagByDelay | None:
    """Returns the lag for each delay from the optima at some delays.

    That is the loss, its slope, the logarithms of lag and gain, and where known the error of the
    lag and the slope of the gain.
    """
    if not optima:
        return None
    at = np.array(sorted(optima))
    columns = np.array([optima[delay] for delay in sorted(optima)]).T
    value, slope, log_lag, gain, error, gain_slope = columns
    loss = np.full(len(delays), np.inf)
    if len(at) == 1:
        loss[np.argmin(np.abs(delays - at))] = 0.0
    else:
        inside = (delays > at[0] - 1e-9) & (delays < at[-1] + 1e-9)
        loss[inside] = scipy.interpolate.CubicHermiteSpline(at, value, slope)(delays[inside])
    known = np.isfinite(error)
    deviation = np.exp(np.interp(delays, at[known], np.log(error[known])))
    return LagByDelay(
        loss - loss.min(),
        np.interp(delays, at, log_lag),
        deviation,
        np.interp(delays, at, gain),
        np.interp(delays, at[known], gain_slope[known]),
    )
