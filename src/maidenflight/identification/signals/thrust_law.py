"""The law of thrust by command: with the battery's voltage or without, and where it ends.

Specific force is regressed on the mean of lagged speed commands and of their squares, on the steps
whose commands stay below a limit. Where a curve over more commands differs from that below the
limit and explains the steps there worse, the motors saturate beyond it.

A motor's speed follows its voltage, the battery's times the duty cycle, so that thrust at a command
falls with the square of a voltage that no firmware makes up for. That law is taken where it needs
no limit and the other does, or explains flight better that neither curve has seen.

Source: Bouabdallah 2007, sec. 2.4 (a motor's speed and its voltage).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter1d

from maidenflight.flights.checkup.relations import block_mean
from maidenflight.flights.log import Flight
from maidenflight.flights.windows import SEGMENT_SECONDS
from maidenflight.identification.signals.flight_signals import STEP, stride
from maidenflight.parameters import Parameters

LIMITS = (np.inf, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4)
"""Speed commands beyond which motors may saturate. These, `MEMORY`, and fewest steps are harmless
within a factor of 1.4 (paper/identification/constants.py)."""
MEMORY = 0.5
"""Time for which a command beyond the limit acts: lag, filters, and memory of the noise [s];
measured with `LIMITS`."""
_FEWEST, _LEAST_SHARE = 200, 0.5
"""Steps, and share of all, that must stay below a limit; measured with `LIMITS`."""
_OTHER, _SURE = 0.1, 3.0
"""Difference of thrust, a share, and standard errors of what it explains, of another curve."""
_SAG = 0.02
"""Share by which the voltage must change for its law to be looked at: twice the step of 0.1 V that
was measured in Betaflight's logs, of three cells."""
_FOLDS, _BINS = 3, 5
"""Parts of flight of which each is judged by the others, and parts of equally many steps, by their
command, in which force is compared; chosen on no log."""


def beyond(command: Float[np.ndarray, "N"], limit: float, period: float) -> Bool[np.ndarray, "N"]:
    """Returns rows that a command beyond the limit acts on.

    Args:
        command: speed, mean of four motors.
        limit: of `LIMITS`.
        period: of a row [s].
    """
    return np.asarray(_recent_peak(command, _memory_rows(period)) > limit)


def _memory_rows(period: float) -> int:
    """Returns the rows of `MEMORY`."""
    return max(1, round(MEMORY / period))


def _recent_peak(command: Float[np.ndarray, "N"], rows: int) -> Float[np.ndarray, "N"]:
    """Returns the greatest of a command over so many rows, in a window that ends at each row."""
    values = np.asarray(command, float)
    return np.asarray(maximum_filter1d(values, rows, axis=0, origin=(rows - 1) // 2))


class ThrustLaw(NamedTuple):
    """How thrust follows commands."""

    limit: float = np.inf
    """Mean speed command of four motors, of `LIMITS`, beyond which motors saturate; or none."""
    volts: float | None = None
    """Battery voltage at which commands ask for their thrust; None: whatever the voltage."""

    def read(self, flights: Sequence[Flight]) -> list[Flight]:
        """Returns the flights with commands as the law reads them."""
        if self.volts is None:
            return list(flights)
        return [
            replace(flight, command=flight.command * ((flight.battery / self.volts) ** 2)[:, None])
            for flight in flights
        ]

    def notes(self) -> list[str]:
        """Returns what the law means for a user."""
        notes = []
        if self.volts is not None:
            notes.append(
                "thrust follows the square of the battery's voltage: thrust_to_weight is that at "
                f"{self.volts:.3g} V, the flights' median."
            )
        if np.isfinite(self.limit):
            notes.append(
                "thrust no longer follows the commands where their mean exceeds "
                f"u = {self.limit**2:.2f} (motors at their limit, or a sagging battery): "
                "parameters are of what lies below, and full thrust is less than "
                "thrust_to_weight says. Keep policies below."
            )
        return notes


def thrust_law(flights: Sequence[Flight], lag: float) -> ThrustLaw:
    """Returns the law that flights with an accelerometer follow; the plain one of others.

    Args:
        flights: checked flights of one rate.
        lag: of the motors, about [s].
    """
    if any(flight.accelerometer is None for flight in flights):
        return ThrustLaw()
    plain = _by_step(flights, lag)
    law = ThrustLaw(_limit(plain))
    volts = np.concatenate([flight.battery for flight in flights])
    if any(flight.by_battery_law for flight in flights) or not np.isfinite(volts).all():
        return law
    middle = float(np.median(volts))
    if np.ptp(np.quantile(volts, [0.05, 0.95])) < _SAG * middle:
        return law
    other = ThrustLaw(volts=middle)
    signals = _by_step(other.read(flights), lag)
    other = other._replace(limit=_limit(signals))
    if other.limit == law.limit:
        used = np.maximum(plain[:, 3], signals[:, 3]) <= law.limit
        losses = [_fold_losses(some[used]) for some in (plain, signals)]
        return other if _is_less(*losses) else law
    return max(law, other, key=lambda law: law.limit)


def note_unexplained(flights: Sequence[Flight], law: ThrustLaw, drone: Parameters) -> list[str]:
    """Returns a note where a drone's thrust is off at some commands, beyond what chance has.

    Args:
        flights: checked flights of one rate, as the law reads them.
        law: that they follow.
        drone: as identified from them.
    """
    if any(flight.accelerometer is None for flight in flights):
        return []
    signals = _by_step(flights, float(drone.motor_time_constant))
    signals = signals[signals[:, 3] <= law.limit]
    offset, linear = float(drone.thrust_offset), float(drone.thrust_linear)
    share = signals[:, :2] @ [linear, 1.0 - offset - linear] + offset
    full = float(drone.gravity * drone.thrust_to_weight)
    edges = np.quantile(signals[:, 0], np.linspace(0.0, 1.0, _BINS + 1))
    worst = (0.0, 0.0, 0.0)
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        here = (signals[:, 0] >= low) & (signals[:, 0] <= high)
        predicted = float(full * share[here].mean())
        # Rows within a second hardly differ in what a law lacks.
        blocks = block_mean(signals[here, 2:3], round(1.0 / STEP))[:, 0]
        if len(blocks) < 2:
            continue
        measured = float(signals[here, 2].mean())
        gap = abs(measured - predicted)
        error = float(blocks.std()) / np.sqrt(len(blocks))
        if gap - _SURE * error > max(_OTHER * predicted, abs(worst[1] - worst[2])):
            worst = float((low + high) / 2), measured, predicted
    if not any(worst):
        return []
    speed, measured, predicted = worst
    return [
        f"no law of thrust explains these flights: about u = {speed**2:.2f} the measured force is "
        f"{measured:.3g} m/s2 and that of the identified drone {predicted:.3g} (fast flight "
        "through air, an accelerometer that slips or has another scale, other limits of the "
        "commands). Do not rely on thrust_to_weight; hover and climb slowly, from a fifth to four "
        "fifths of the throttle."
    ]


def _limit(signals: Float[np.ndarray, "M 4"]) -> float:
    """Returns the limit of `LIMITS` beyond which thrust follows another curve; infinite if none."""
    count = len(signals)
    fits = []
    for limit in LIMITS:
        used = signals[:, 3] <= limit
        if used.sum() < max(_FEWEST, _LEAST_SHARE * count):
            break
        fits.append((limit, used, _curve(signals[used])))
    for index, (limit, _, curve) in enumerate(fits):
        if not any(_differs(signals[used], curve, other) for _, used, other in fits[index + 1 :]):
            return float(limit)
    return np.inf


def _curve(signals: Float[np.ndarray, "M 4"]) -> Float[np.ndarray, "2"]:
    return np.linalg.lstsq(signals[:, :2], signals[:, 2], rcond=None)[0]


def _fold_losses(signals: Float[np.ndarray, "M 4"]) -> Float[np.ndarray, "M"]:
    """Squared errors of force by step, by the curve of other segments."""
    part = np.arange(len(signals)) // round(SEGMENT_SECONDS / STEP) % _FOLDS
    losses = np.zeros(len(signals))
    for number in range(_FOLDS):
        mine = part == number
        losses[mine] = (signals[mine, 2] - signals[mine, :2] @ _curve(signals[~mine])) ** 2
    return losses


def _by_step(flights: Sequence[Flight], lag: float) -> Float[np.ndarray, "M 4"]:
    """What `_regressors` returns, of all flights."""
    return np.concatenate([np.empty((0, 4)), *(_regressors(flight, lag) for flight in flights)])


def _regressors(flight: Flight, lag: float) -> Float[np.ndarray, "M 4"]:
    """Speed, its square, specific force along z, and the greatest command of late, by step."""
    decay = np.exp(-flight.period / max(lag, 1e-3))
    command, start = flight.speed_command, decay * flight.speed_command[:1]
    speed = scipy.signal.lfilter([1 - decay], [1.0, -decay], command, axis=0, zi=start)[0]
    late = round(flight.accelerometer_delay / flight.period)
    force = np.asarray(flight.accelerometer, float)[:, 2]
    rows = _memory_rows(flight.period)
    most = _recent_peak(command.mean(axis=1), rows)
    columns = [speed.mean(axis=1), (speed**2).mean(axis=1)]
    # A slow filter acts on what is compared with it too.
    smooth = max(1, round(2 * flight.accelerometer_delay / flight.period))
    weights = np.ones(smooth) / smooth
    columns[:2] = [scipy.signal.lfilter(weights, [1.0], column) for column in columns[:2]]
    shift = max(0, late - smooth // 2)
    table = np.column_stack([*columns[:2], np.roll(force, -shift), most])
    return block_mean(table[rows : len(table) - shift], stride(flight))


def _differs(
    signals: Float[np.ndarray, "M 4"], curve: Float[np.ndarray, "2"], other: Float[np.ndarray, "2"]
) -> bool:
    """Tests whether a curve explains steps worse than their own, and gives another thrust."""
    mine, theirs = (signals[:, :2] @ coefficients for coefficients in (curve, other))
    size = np.quantile(signals[:, 0], [0.1, 0.9])
    ends = np.stack([size, size**2], axis=1)
    gap = np.abs(ends @ curve - ends @ other) / np.maximum(np.abs(ends @ other), 1.0)
    losses = ((signals[:, 2] - thrust) ** 2 for thrust in (mine, theirs))
    return bool(gap.max() > _OTHER and _is_less(*losses))


def _is_less(loss: Float[np.ndarray, "M"], other: Float[np.ndarray, "M"]) -> bool:
    """Tests whether the other loss is surely the lesser, over seconds of flight."""
    blocks = block_mean((loss - other)[:, None], round(1.0 / STEP))[:, 0]
    error = float(blocks.std()) / np.sqrt(max(len(blocks), 1))
    return bool(len(blocks) and blocks.mean() > _SURE * max(error, 1e-12))
