"""How noisy a drone and its sensors are, from what one-step errors leave unexplained.

How long a policy flies depends on noise: random-walk drift of the estimates and disturbances excite
the drone. The levels follow in closed form from the products of errors with earlier errors.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from maidenflight.flights.log import Flight
from maidenflight.identification.signals.flight_signals import stride
from maidenflight.parameters import Parameters, levers
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.physics.sensors import lean_rates, walk_factor, way_of_turn

ROWS = 8
"""Rows over which noise is measured, at most: 0.08 s at 100 Hz, in which a policy reacts. Over
longer times the random-walk drift of an estimator is smaller."""
_POSITION, _HEIGHT, _VELOCITY, _ATTITUDE, _TURN = map(slice, (0, 2, 3, 6, 9), (2, 3, 5, 9, 11))
"""Columns, by definition of `one_step_errors.errors`: horizontal position, height, horizontal
velocity, attitude, roll and pitch rate."""
WALKS = ("position_walk", "height_walk", "velocity_walk", "turn_drift")
"""Of an estimate: random walks, and what turns move."""
_WINDOW = 0.5
"""Time over which a position is compared with the tilt [s]: moves no estimate but that of noise
(paper/identification/constants.py)."""
_OF_WALK = 3 / 70
"""Variance that a parabola leaves of a random walk, of its strength squared times its duration:
by definition of a Wiener process 1/2 less 1/3, 1/10, 1/42, its parts along Legendre polynomials."""
_CONTRADICTED = 1 / 3
"""Share of a walk of position that tilt must contradict, or there is none: likewise
(paper/identification/constants.py)."""


def noise_levels(
    products: Float[np.ndarray, "12 P+1 P+1"], parameters: Parameters, period: float
) -> dict[str, float]:
    """Returns the noise that makes a simulated drone's one-step errors alike.

    Position and velocity walk as far as their errors add up over `ROWS` rows; what cancels is their
    white noise. Height walks by itself: a ranger measures it, seven times better than optical flow
    measures the way in the authors' flights. Of the body rates' errors, the part that is gone after
    one row is the gyro's; the rest is what the actuators' noise must make, with the correlation
    that it has. The estimated attitude's error is what its autoregression cannot foresee.

    What is constant over a segment of flight is a trim, which differs from flight to flight, and no
    noise: left in, the authors' flights have twice the actuators' noise, five times as slow.

    Args:
        products: mean products of one-step errors with their past, about the means of their
            segments, in the columns of `one_step_errors.errors` (m, m/s, rad, rad/s).
        parameters: the drone; its motors' torque and its inertia turn torque noise into thrust
            noise.
        period: time between two rows [s].

    Returns:
        Values of `Parameters` fields, SI units.
    """
    products = products[:, : ROWS + 1, : ROWS + 1]
    order = products.shape[1] - 1
    covariance = np.stack(
        [np.mean(np.diagonal(products, lag, 1, 2), axis=1) for lag in range(order + 1)], axis=1
    )
    # The variance of a sum over P + 1 rows, by row; lags count less the fewer pairs of rows have
    # them (Newey and West 1987). White noise of a measurement adds twice its variance to one row,
    # but hardly to the sum, in which it cancels.
    fewer = 1 - np.arange(1, order + 1) / (order + 1)
    summed = covariance[:, 0] + 2 * covariance[:, 1:] @ fewer
    white = np.maximum(covariance[:, 0] - summed, 0.0) / 2 * (order + 1) / order
    walked = np.maximum(summed - 2 * white / (order + 1), 0.0) / period

    def size(variances: np.ndarray, columns: slice) -> float:
        return float(np.sqrt(np.mean(variances[columns])))

    past, now = products[_ATTITUDE, 1:, 1:], products[_ATTITUDE, 1:, 0]
    foreseen = np.sum(
        now * np.linalg.solve(past + 1e-15 * np.eye(order), now[..., None])[..., 0], axis=1
    )
    attitude = np.sqrt(np.maximum(products[_ATTITUDE, 0, 0] - foreseen, 0.0) / 2)

    turn = covariance[_TURN]
    gyro = np.maximum((turn[:, 0] + turn[:, 2]) / 2 - turn[:, 1], 0.0) / 2
    disturbance = np.maximum(turn[:, 0] - 2 * gyro, 1e-12)
    # An Ornstein-Uhlenbeck process forgets at the rate at which its covariance falls; a straight
    # line through its logarithm.
    gain = np.maximum(turn[:, 2:] / disturbance[:, None], 1e-3)
    lags = np.arange(2, order + 1) * period
    rate = np.maximum(-np.mean(np.log(gain) @ lags) / (lags @ lags), 0.1)
    full = float(parameters.mass * parameters.gravity / 4 * parameters.thrust_to_weight)
    # Independent noise of four thrusts adds up in squares.
    lever = np.linalg.norm(levers(parameters)[:, :2], axis=0)
    per_thrust = lever * full / np.asarray(parameters.inertia, float)[:2]
    thrust = np.sqrt(disturbance) / period / per_thrust
    return {
        "position_walk": size(walked, _POSITION),
        "height_walk": size(walked, _HEIGHT),
        "position_noise": size(white, _POSITION),
        "position_noise_uniform": 0.0,
        "velocity_walk": size(walked, _VELOCITY),
        "velocity_noise": size(white, _VELOCITY),
        "attitude_noise": float(np.sqrt(np.mean(attitude**2))),
        "attitude_noise_uniform": 0.0,
        "gyro_noise": float(np.sqrt(np.mean(gyro))),
        "actuator_noise": float(np.sqrt(np.mean(thrust**2))),
        "actuator_noise_rate": float(rate),
        "turn_drift": float(parameters.turn_drift),
    }


def correct_walks(noise: dict[str, float], flights: Sequence[Flight]) -> dict[str, float]:
    """Returns the noise with the walks of a drone that does not turn, or without false ones.

    Walks are false where position moves as the drone's tilt accelerates it. Estimates of velocity
    and position in a motion capture differ as after a walk, since velocity is of another scale (6 %
    too large in logs of a Crazyflie) and in steps; but position holds both. What walks bends the
    path where no tilt does: 7 mm in half a second under optical flow, 0.2 mm in motion captures.

    Args:
        noise: of `noise_levels`.
        flights: checked flights with a state.
    """
    if against_tilt(flights) <= _CONTRADICTED * noise["position_walk"]:
        return {**noise, **dict.fromkeys(WALKS, 0.0)}
    rates = np.concatenate([flight.body_rates for flight in flights])
    further = float(np.sqrt(np.mean(walk_factor(rates) ** 2)))
    across = {name: noise[name] / further for name in ("position_walk", "velocity_walk")}
    return {**noise, **across}


def drift_by_turns(flights: Sequence[Flight]) -> float:
    """Returns the way of the estimated position as the drone tilts by a radian [m/rad].

    By least squares over the steps of horizontal position that velocity does not explain.

    Args:
        flights: checked flights with a state.

    Source: see `sensors.way_of_turn`.
    """
    across = total = 0.0
    for flight in flights:
        every = stride(flight)
        if len(flight) < 5 * every:
            continue
        period = every * flight.period
        position, speed, rates, attitude = (
            values[::every].astype(float)
            for values in (flight.position, flight.velocity, flight.body_rates, flight.attitude)
        )
        quaternion = Rotation.from_euler("ZYX", attitude[:, ::-1]).as_quat()
        states = State(position.T, speed.T, quaternion.T, rates.T, np.empty(0))  # type: ignore[arg-type]
        lean = np.stack(lean_rates(states), axis=1)
        step = np.diff(position, axis=0) - period * (speed[1:] + speed[:-1]) / 2
        # Over three rows, in which the gyro's noise is a third of that between two.
        turn = way_of_turn(lean[2:-1], lean[1:-2], (lean[3:] - lean[:-3]) / 3, period)
        turn -= turn.mean(axis=0)
        across += float(np.sum(turn * step[1:-1, :2]))
        total += float(np.sum(turn**2))
    return across / max(total, 1e-12)


def against_tilt(flights: Sequence[Flight]) -> float:
    """Returns the walk that position shows against twice the integral of the tilt [m/sqrt(s)].

    The median over windows, in each of which the begin, speed, a constant acceleration, such as of
    wind or of a wrong attitude, and the gain of the tilt are free.

    Args:
        flights: checked flights with a state; infinite where none is long enough.
    """
    residuals = []
    for flight in flights:
        every = stride(flight)
        step, rows = every * flight.period, round(_WINDOW / (every * flight.period))
        up = Rotation.from_euler("ZYX", flight.attitude[::every, ::-1].astype(float)).apply(
            [0, 0, 1]
        )
        bent = (
            np.cumsum(np.cumsum(up[:, :2] / np.maximum(up[:, 2:], 0.1), axis=0), axis=0) * step**2
        )
        position = flight.position[::every, :2].astype(float)
        time = np.linspace(-1.0, 1.0, rows)
        for begin in range(0, len(position) - rows + 1, rows):
            part = slice(begin, begin + rows)
            for axis in range(2):
                free = np.stack([time**0, time, time**2, bent[part, axis]], axis=1)
                left = position[part, axis] - free @ np.linalg.lstsq(free, position[part, axis])[0]
                residuals.append(np.mean(left**2) / (_OF_WALK * _WINDOW))
    return float(np.sqrt(np.median(residuals))) if residuals else np.inf
