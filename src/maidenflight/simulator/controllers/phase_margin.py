"""Phase margin of the firmware's loop of body rates about a drone: what latency it still bears.

About roll or pitch the loop is linear near hover: a discrete PID at 500 Hz, counts of torque that
motors hold and that reach them after the latency, sqrt(u), the rotors' lag, the thrust's slope,
inertia, and the gyro's filter. A zero-order hold with any delay has an exact discrete form, so that
nothing is approximated but the lag of motors that slow down slower than they speed up, by
`dynamics.equivalent_lag`.

Source: Åström and Wittenmark 1997, Computer-controlled systems, sec. 2.3 (hold and fractional
delay) and 3.3 (margins); the loop is that of `rate_loops`.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Complex, Float

from maidenflight.parameters import Parameters, frames
from maidenflight.parameters.platforms import platform_of
from maidenflight.simulator.controllers.pid import ATTITUDE_RATE
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.battery import COUNTS

PERIOD = 1.0 / ATTITUDE_RATE
_DEGREE = float(np.degrees(1.0))
_SOUND = np.radians(20.0)
"""Phase that gains should leave; ours."""


class RateLoop(NamedTuple):
    """The loop opened at the PID's output, from counts of torque to degrees per second."""

    step: Float[np.ndarray, "3 3"]
    """Of rotor speed, body rate and filtered body rate, over a period."""
    newer: Float[np.ndarray, "3"]
    """What the command of `periods` ago adds."""
    older: Float[np.ndarray, "3"]
    """What the one before it adds."""
    periods: int
    """Whole periods of the latency."""
    gains: tuple[float, float, float]
    """Proportional, integral and derivative."""

    def response(self, frequency: Float[np.ndarray, "N"]) -> Complex[np.ndarray, "N"]:
        """Returns the open loop's frequency response.

        Args:
            frequency: [rad/s], below half of the loop's own.
        """
        z = np.exp(1j * frequency * PERIOD)
        kp, ki, kd = self.gains
        pid = kp + ki * PERIOD / (1.0 - 1.0 / z) + kd * (1.0 - 1.0 / z) / PERIOD
        inputs = self.newer + self.older / z[:, None]
        state = np.linalg.solve(z[:, None, None] * np.eye(3) - self.step, inputs[..., None])
        return pid * state[:, 2, 0] * z**-self.periods

    def is_stable(self) -> bool:
        """Returns whether the closed loop's poles all lie within the unit circle."""
        kp, ki, kd = self.gains
        size = 3 + 2 + self.periods + 1
        closed = np.zeros((size, size))
        # Three of the drone, the integral, the last measurement, then commands, newest first.
        rate, summed, last, line = 2, 3, 4, 5
        command = np.zeros(size)
        command[rate] = -kp - ki * PERIOD - kd / PERIOD
        command[summed], command[last] = ki, kd / PERIOD
        closed[:3, :3] = self.step
        newer = np.eye(size)[line + self.periods - 1] if self.periods else command
        older = np.eye(size)[line + self.periods]
        closed[:3] += np.outer(self.newer, newer) + np.outer(self.older, older)
        closed[summed, summed], closed[summed, rate] = 1.0, -PERIOD
        closed[last, rate] = 1.0
        closed[line] = command
        closed[line + 1 :, line:-1] = np.eye(self.periods)
        return bool(np.abs(np.linalg.eigvals(closed)).max() < 1.0)


class Margin(NamedTuple):
    """How much phase a loop has left."""

    phase: float
    """At the crossover [rad]; negative where the loop is unstable."""
    crossover: float
    """Where the gain is 1 [rad/s]."""


def rate_loop(
    drone: Parameters,
    axis: int,
    full_scale_counts: float = COUNTS,
    later: float = 0.0,
    share: float = 1.0,
) -> RateLoop:
    """Returns the loop of body rates of a drone's platform about roll (0) or pitch (1).

    Args:
        drone: a point.
        axis: 0 or 1.
        full_scale_counts: see `ControlInterface`.
        later: further latency [s].
        share: of the platform's gains.
    """
    mixer = np.array(frames.mixer_of(drone) or frames.CRAZYFLIE)[:, 1 + axis]
    speed = float(np.sqrt(dynamics.hover_command(drone)))
    linear, offset = float(drone.thrust_linear), float(drone.thrust_offset)
    slope = linear + 2.0 * (1.0 - linear - offset) * speed
    most = float(drone.thrust_to_weight * drone.mass * drone.gravity) / 4.0
    arms = np.asarray(drone.rotor_thrust) * frames.levers(drone)[:, axis]
    inertia = float(drone.inertia[axis])
    torque = float(mixer @ arms) * most * slope / inertia
    lag = float(dynamics.equivalent_lag(drone.motor_time_constant, drone.spin_down_ratio))
    filtering = max(float(drone.gyro_time_constant), 1e-6)
    rates = np.array(
        [
            [-1.0 / lag, 0.0, 0.0],
            [torque, -float(drone.rotational_damping) / inertia, 0.0],
            [0.0, 1.0 / filtering, -1.0 / filtering],
        ]
    )
    drive = np.array([_DEGREE / (2.0 * speed * full_scale_counts * lag), 0.0, 0.0])
    both = np.zeros((4, 4))
    both[:3, :3], both[:3, 3] = rates, drive
    whole, rest = divmod(float(drone.latency) + later, PERIOD)
    # All at once: each call may wake several cores for sixteen numbers.
    moved = scipy.linalg.expm(np.multiply.outer([PERIOD, PERIOD - rest, rest], both))
    step, since, _ = moved[:, :3, :3]
    _, newer, before = moved[:, :3, 3]
    rows = platform_of(drone.platform).rate
    kp, ki, kd = (share * row[axis] for row in (rows.proportional, rows.integral, rows.derivative))
    return RateLoop(step, newer, since @ before, int(whole), (kp, ki, kd))


def phase_margin(loop: RateLoop) -> Margin:
    """Returns the least phase margin of a loop over its crossovers."""
    frequency = np.geomspace(0.1, 0.999 * np.pi / PERIOD, 1000)
    response = loop.response(frequency)
    gain, phase = np.log(np.abs(response)), np.unwrap(np.angle(response))
    # From the integral and the body's inertia on, two integrations: -180 deg.
    phase += 2.0 * np.pi * np.round((-np.pi - phase[0]) / (2.0 * np.pi))
    indices = np.flatnonzero((gain[:-1] > 0.0) & (gain[1:] <= 0.0))
    margins = []
    for index in indices:
        share = gain[index] / (gain[index] - gain[index + 1])
        at, about = (
            np.interp(share, [0, 1], curve[index : index + 2]) for curve in (frequency, phase)
        )
        margins.append(Margin(float(about + np.pi), float(at)))
    return min(margins)


def rate_margin(
    drone: Parameters, full_scale_counts: float = COUNTS, later: float = 0.0, share: float = 1.0
) -> Margin:
    """Returns the lesser phase margin of a drone's loops about roll and pitch; see `rate_loop`."""
    loops = (rate_loop(drone, axis, full_scale_counts, later, share) for axis in (0, 1))
    return min(map(phase_margin, loops))


def describe_rate_loop(
    name: str, drone: Parameters, full_scale_counts: float = COUNTS, later: float = 0.01
) -> str:
    """Returns a sentence on the phase that a drone's rate loop has left, and what to do.

    Args:
        name: of the drone.
        drone: a point.
        full_scale_counts: see `ControlInterface`.
        later: further latency that it should bear [s].
    """
    now, then = (rate_margin(drone, full_scale_counts, more).phase for more in (0.0, later))
    sentence = (
        f"{name}: the firmware's rate loop has {_DEGREE * now:.0f} deg of phase left, "
        f"{_DEGREE * then:.0f} with {1e3 * later:g} ms more."
    )
    if then >= 0.0:
        return sentence
    shares = np.linspace(0.95, 0.05, 19)
    fits = (
        share for share in shares if rate_margin(drone, full_scale_counts, later, share)[0] > _SOUND
    )
    share = next(fits, None)
    gains = "" if share is None else f", or give its rate PIDs {share:.0%} of their gains"
    which = "itself" if now < 0.0 else f"with {1e3 * later:g} ms more"
    return f"{sentence} It cannot hold the drone {which}: command the motors (pwm){gains}."


def most_latency(drone: Parameters, full_scale_counts: float = COUNTS) -> float:
    """Returns how much more latency a drone's loops bear before one is unstable [s], from 0."""
    phase, crossover = rate_margin(drone, full_scale_counts)
    return max(phase, 0.0) / crossover
