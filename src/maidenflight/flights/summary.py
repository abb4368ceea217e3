"""What logs hold: signals, rates, and how much a flight moves the drone."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from maidenflight.flights.checks.checking import SHORTEST_ROWS
from maidenflight.flights.log import SUBSAMPLED, TORQUES, ZERO_ORDER_HOLD, Flight, by_log

CALM, CALM_RAD_S = 0.02, 1.0
"""Spread of the motors' differences [-] below which a flight is calm: inertia, lag and latency show
in what commands change. Hovers of real Crazyflies have 0.010 to 0.015, slow flights up to 0.03."""
QUANTITIES: tuple[str, ...] = ("lag", "inertia x", "inertia y", "torque z", "thrust", "drag")
"""What logs are ranked by."""
MOST_SHARE = 0.8
"""Of what all logs tell, what the chosen ones hold."""
_BAND_HZ = (1.0, 15.0)
"""Where commands explain most of the motion of small quadrotors (paper/notes/identification.md)."""


@dataclass(frozen=True)
class Summary:
    """What one log holds, of the pieces that can be used."""

    name: str
    pieces: int
    seconds: float
    """Of all pieces [s]."""
    rate: float
    """Rows a second [Hz]."""
    signals: tuple[str, ...]
    """What was measured: fields of `Flight`, those that hold numbers."""
    commands: str
    """What a command stands for, `log.ZERO_ORDER_HOLD` or `log.SUBSAMPLED`."""
    simulated: str
    """The virtual drone that flew; empty for a real flight."""
    battery: tuple[float, float] | None
    """Lowest and highest voltage [V]; None where it is not known."""
    speed: float | None
    """Root mean square of the velocity [m/s]; None without a velocity."""
    tilt: float | None
    """Largest tilt [rad]; None without an attitude."""
    body_rates: float
    """Root mean square of the body rates about x and y [rad/s]."""
    command: float
    """Mean thrust command u [-]."""
    thrust_spread: float
    """Standard deviation of the mean of the four commands [-]."""
    torque_spread: float
    """Standard deviation of what rolls and pitches the drone, a quarter of the commands' signed
    sum, the larger of both [-]."""

    information: Mapping[str, float]
    """What the log says of quantities of `QUANTITIES`, in a unit that logs of one drone share."""

    @property
    def is_calm(self) -> bool:
        """Whether the motors differ little, so that another flight would tell more of them."""
        return self.torque_spread < CALM and self.body_rates < CALM_RAD_S


def rank(logs: Sequence[Summary]) -> list[tuple[Summary, dict[str, float]]]:
    """Returns logs by what they tell, the most telling first.

    Returns:
        Each log with its share of what all together say of each quantity; their mean ranks it.
    """
    totals = {name: sum(log.information.get(name, 0.0) for log in logs) for name in QUANTITIES}
    shares = [
        {name: log.information.get(name, 0.0) / all_ for name, all_ in totals.items() if all_ > 0}
        for log in logs
    ]
    order = sorted(range(len(logs)), key=lambda index: -sum(shares[index].values()))
    return [(logs[index], shares[index]) for index in order]


def choose_most_telling(
    ranked: Sequence[tuple[Summary, Mapping[str, float]]], share: float = MOST_SHARE
) -> list[Summary]:
    """Chooses the fewest logs of `rank`, from the first on, that hold a share of all quantities."""
    totals: Counter[str] = Counter()
    for count, (_, shares) in enumerate(ranked):
        if all(totals[name] >= share for name in shares):
            return [log for log, _ in ranked[:count]]
        totals.update(shares)
    return [log for log, _ in ranked]


def summaries(flights: Iterable[Flight]) -> tuple[Summary, ...]:
    """Returns a summary of each log, in the order of the flights.

    Args:
        flights: checked pieces of flights; those of one name are of one log.
    """
    return tuple(_summary(name, pieces) for name, pieces in by_log(flights).items())


def _summary(name: str, pieces: list[Flight]) -> Summary:
    first = pieces[0]

    def joined(field: str) -> np.ndarray:
        return np.concatenate([np.asarray(getattr(piece, field), float) for piece in pieces])

    signals = tuple(
        field
        for field in first.arrays
        if field not in ("command", "true_position") and np.isfinite(joined(field)).any()
    )
    command, attitude, volts = joined("command"), joined("attitude"), joined("battery")
    level = np.cos(attitude[:, 0]) * np.cos(attitude[:, 1])
    turning = command @ TORQUES[:, :2] / 4
    battery = (float(np.nanmin(volts)), float(np.nanmax(volts))) if "battery" in signals else None
    tilt = float(np.arccos(np.nanmin(level).clip(-1, 1))) if "attitude" in signals else None
    return Summary(
        name=name,
        pieces=len(pieces),
        seconds=sum(piece.duration for piece in pieces),
        rate=1 / first.period,
        signals=signals,
        commands=ZERO_ORDER_HOLD if first.zero_order_hold else SUBSAMPLED,
        simulated=first.simulated,
        battery=battery,
        speed=_size(joined("velocity")) if "velocity" in signals else None,
        tilt=tilt,
        body_rates=_size(joined("body_rates")[:, :2]),
        command=float(command.mean()),
        thrust_spread=float(command.mean(axis=1).std()),
        torque_spread=float(turning.std(axis=0).max()),
        information=_information(pieces),
    )


def _information(pieces: Iterable[Flight]) -> dict[str, float]:
    """Returns the integral of what excites each quantity, squared: its information but for noise.

    Accelerations are gains times commands that lag; noise is taken as that of the drone's sensors,
    alike in all logs. A lag shows in the commands' change.

    Source: Ljung 1999, System Identification, sec. 9.4 (information of a gain and of a delay).
    """
    sums: dict[str, float] = dict.fromkeys(QUANTITIES, 0.0)
    for piece in pieces:
        fast = min(_BAND_HZ[1], 0.4 / piece.period)
        if len(piece) < SHORTEST_ROWS or fast <= _BAND_HZ[0]:
            continue
        command = np.asarray(piece.command, float)
        edges = _BAND_HZ[0], fast
        band = scipy.signal.butter(2, edges, "band", fs=1 / piece.period, output="sos")
        torques = scipy.signal.sosfiltfilt(band, command @ TORQUES / 4, axis=0)
        change = np.gradient(torques[:, :2], piece.period, axis=0)
        thrust = command.mean(axis=1)
        parts = {
            "lag": (change**2).sum(axis=1),
            "inertia x": torques[:, 0] ** 2,
            "inertia y": torques[:, 1] ** 2,
            "torque z": torques[:, 2] ** 2,
            "thrust": (thrust - thrust.mean()) ** 2,
            "drag": (piece.velocity.astype(float) ** 2).sum(axis=1) if piece.has_state else [0.0],
        }
        for name, squares in parts.items():
            sums[name] += float(np.nansum(squares)) * piece.period
    return sums


def _size(vectors: np.ndarray) -> float:
    """Root mean square of their lengths."""
    return float(np.sqrt(np.nanmean(np.sum(vectors**2, axis=1))))
