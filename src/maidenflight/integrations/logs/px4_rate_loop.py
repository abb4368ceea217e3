"""Torque set-points between two that a PX4 log holds, from its gyro and its rate controller.

PX4's default profile logs the gyro at 200 to 250 Hz and what the rate controller makes of it at 50
Hz. Between two rows that answers the gyro's noise too, so that their mean is not what the motors
were told: inertia comes out 10 to 40 % too large. The controller's gains are parameters,

    torque = K [P (setpoint - rate) + I integral - D change of the rate] + FF setpoint

and its filters are known. What this lacks at logged set-points, such as the gyro's bias in the
integral and its limits, changes slowly: it is smoothed and interpolated. Logged set-points judge
it: of what each second one differs by from the mean of its neighbours, most must be explained.

Source: PX4 v1.14, src/lib/rate_control/rate_control.cpp (update), src/modules/mc_rate_control
(MC_*RATE_*), src/modules/sensors/vehicle_angular_velocity (IMU_GYRO_CUTOFF: low-pass filter of
second order; IMU_DGYRO_CUTOFF: of first order).
"""

import numpy as np
import scipy
from jaxtyping import Float

from maidenflight.flights.streams import streams
from maidenflight.flights.streams.streams import Stream
from maidenflight.integrations.logs.px4_topics import (
    GYRO_CUTOFF,
    Parameters,
    Topics,
    columns,
    middle_of,
    vector,
)

TOPIC = "vehicle_rates_setpoint"
FASTER = 2.0
"""Times the set-points' rate from which the gyro tells what lies between them."""
LEAST_SHARE = 0.5
"""Share of the variance of a set-point about its neighbours' mean that must be explained."""
SLOW = 0.3
"""Standard deviation of the time over which what is lacking is averaged [s]. Single rows hold
vibration, which gyro and set-points fold differently. Of 0.03 to 3 s this foretells best a
set-point that is left out, in each of three real logs (paper/notes/identification.md)."""
_AXES = ("ROLL", "PITCH", "YAW")
_GAINS = {
    "P": (0.15, 0.15, 0.2),
    "I": (0.2, 0.2, 0.1),
    "D": (0.003, 0.003, 0.0),
    "FF": (0.0, 0.0, 0.0),
    "K": (1.0, 1.0, 1.0),
}
"""PX4's usual gains, about roll, pitch and yaw (mc_rate_control_params.c)."""
_CHANGE_CUTOFF = 30.0
"""Usual IMU_DGYRO_CUTOFF [Hz] (imu_gyro_parameters.c)."""
_RATE = 1000.0
"""Rate at which the filters are computed [Hz]; PX4's is 400 to 2000 Hz."""


def between(setpoints: Stream, topics: Topics, parameters: Parameters) -> tuple[Stream, str]:
    """Returns set-points at the gyro's times, and a note; the same where they cannot be told.

    Args:
        setpoints: torque about x, y, z and thrust along z, as logged.
        topics: as recorded.
        parameters: PX4's.
    """
    gyro = columns(topics, "sensor_combined", *vector("gyro_rad", 3), "gyro_integral_dt")
    desired = columns(topics, TOPIC, "roll", "pitch", "yaw")
    if gyro is None or desired is None or min(len(gyro[0]), len(desired[0])) < 3:
        return setpoints, ""
    # Means over the integration time belong to its middle; a simulator's may be samples.
    middle = middle_of(gyro[0], gyro[1][:, 3])
    best, least, shares = None, LEAST_SHARE, np.zeros(3)
    for time in (middle, gyro[0]):
        measured = streams.stream(time, gyro[1][:, :3])
        if measured.rate < FASTER * setpoints.rate:
            return setpoints, ""
        answer = _answer(measured, streams.stream(*desired), parameters)
        explained = _explained(setpoints, answer)
        if min(explained[:2]) > least:
            best, least, shares = answer, min(explained[:2]), explained
    if best is None:
        return setpoints, ""
    at = streams.stream(middle, gyro[1]).time
    at = at[(at >= setpoints.time[0]) & (at <= setpoints.time[-1])]
    values = streams.between(at, setpoints)
    axes = np.flatnonzero(shares > LEAST_SHARE)
    lacking = setpoints.values[:, axes] - _on_lines(setpoints.time, best)[:, axes]
    lacking = scipy.ndimage.gaussian_filter1d(lacking, SLOW / setpoints.step, axis=0)
    slow = streams.between(at, Stream(setpoints.time, lacking))
    values[:, axes] = _on_lines(at, best)[:, axes] + slow
    known = np.isfinite(values).all(axis=1)
    note = (
        f"; between them by gyro and rate controller (MC_*RATE_*), {100 * least:.0f} % of what a "
        "set-point differs by from its neighbours"
    )
    return Stream(at[known], values[known]), note


def _answer(measured: Stream, desired: Stream, parameters: Parameters) -> Stream:
    """What the gains make of the gyro, at `_RATE`."""

    def gain(name: str) -> Float[np.ndarray, "3"]:
        keys = zip(_AXES, _GAINS[name], strict=True)
        return np.array([parameters.get(f"MC_{axis}RATE_{name}", usual) for axis, usual in keys])

    known = measured.part(np.asarray(np.isfinite(measured.values).all(axis=1)))
    at = np.arange(known.time[0], known.time[-1], 1 / _RATE)
    rates = _on_lines(at, known)
    cutoff = parameters.get("IMU_GYRO_CUTOFF", GYRO_CUTOFF)
    if 0.0 < cutoff < _RATE / 2:
        above, below = scipy.signal.butter(2, cutoff, fs=_RATE)
        rates = scipy.signal.lfilter(above, below, rates - rates[0], axis=0) + rates[0]
    change = np.diff(rates, axis=0, prepend=rates[:1]) * _RATE
    cutoff = parameters.get("IMU_DGYRO_CUTOFF", _CHANGE_CUTOFF)
    if cutoff > 0.0:
        share = 1 / (1 + _RATE / (2 * np.pi * cutoff))
        change = scipy.signal.lfilter([share], [1.0, share - 1.0], change, axis=0)
    target = _on_lines(at, desired.part(np.asarray(np.isfinite(desired.values).all(axis=1))))
    error = target - rates
    integral = np.cumsum(error, axis=0) / _RATE
    answer = gain("P") * error + gain("I") * integral - gain("D") * change
    return Stream(at, gain("K") * answer + gain("FF") * target)


def _on_lines(at: Float[np.ndarray, "N"], signal: Stream) -> Float[np.ndarray, "N K"]:
    return np.stack([np.interp(at, signal.time, column) for column in signal.values.T], axis=1)


def _explained(setpoints: Stream, answer: Stream) -> Float[np.ndarray, "3"]:
    """Share of the variance of torques about the mean of their neighbours, by axis."""
    inside = (setpoints.time > answer.time[0]) & (setpoints.time < answer.time[-1])
    logged = setpoints.part(inside)
    near = np.diff(logged.time[::2])[: len(logged.time[1:-1:2])] < 3 * setpoints.step

    def news(values: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "H 3"]:
        middle = values[1:-1:2]
        return (middle - 0.5 * (values[:-2:2] + values[2::2])[: len(middle)])[near]

    measured = news(logged.values[:, :3])
    left = measured - news(_on_lines(logged.time, answer))
    return 1 - left.var(axis=0) / np.maximum(measured.var(axis=0), 1e-30)
