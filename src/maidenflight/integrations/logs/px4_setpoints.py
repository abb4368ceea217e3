"""Motors of a PX4 log that holds them too rarely, from its torque and thrust set-points.

What is logged of the motors checks what is rebuilt, at the same instants. PX4 1.13 and later log
`vehicle_torque_setpoint` and `vehicle_thrust_setpoint`, older ones `actuator_controls_0` (roll,
pitch, yaw, thrust upwards), whose mixer for a quadrotor in X is the allocation of four equal arms.

Source: PX4 v1.14, msg/VehicleTorqueSetpoint.msg, msg/VehicleThrustSetpoint.msg; v1.12,
src/lib/mixer/MultirotorMixer/geometries/quad_x.toml.
"""

import numpy as np

from maidenflight.errors import InputError
from maidenflight.flights.streams import agreement, rates, streams
from maidenflight.flights.streams.streams import Stream
from maidenflight.integrations.logs import px4_allocation, px4_rate_loop
from maidenflight.integrations.logs.px4_allocation import Rotor
from maidenflight.integrations.logs.px4_topics import REMEDY, Parameters, Topics, columns, vector

TOPICS = (
    "vehicle_torque_setpoint",
    "vehicle_thrust_setpoint",
    "actuator_controls_0",
    px4_rate_loop.TOPIC,
)
_TOGETHER = 1e-3
"""Time within which a set-point and motors belong together [s]."""
_QUAD_X = (
    Rotor(1.0, 1.0),
    Rotor(-1.0, -1.0),
    Rotor(1.0, -1.0, moment=-0.05),
    Rotor(-1.0, 1.0, moment=-0.05),
)
"""Source: quad_x.toml, see above, by which moments count in proportion alone."""


def motors(
    name: str, topics: Topics, parameters: Parameters, logged: Stream
) -> tuple[Stream, str] | None:
    """Commands of PX4's motors, as `actuator_motors`, at the rate of the set-points, and a note.

    Args:
        name: of the file, for errors and notes.
        topics: as recorded.
        parameters: PX4's.
        logged: commands of PX4's motors as far as they were logged.

    Returns:
        None where the motors are logged often enough, or the set-points are not.

    Raises:
        InputError: the logged motors contradict what is rebuilt.
    """
    if logged.rate >= 0.97 * rates.LEAST_HZ:
        return None
    setpoints, topic = _setpoints(topics)
    if setpoints is None or setpoints.rate < 0.97 * rates.LEAST_HZ:
        return None
    rotors = _rotors(parameters)

    def allocated(some: Stream) -> Stream:
        airmode = int(parameters.get("MC_AIRMODE", 0))
        return Stream(some.time, px4_allocation.motors(some.values, rotors or _QUAD_X, airmode))

    rebuilt = allocated(setpoints)
    share = _explained(logged, rebuilt)
    faster, more = px4_rate_loop.between(setpoints, topics, parameters)
    rebuilt = allocated(faster) if more else rebuilt
    mixer = "the logged allocation (CA_ROTORn)" if rotors else "PX4's mixer of a quadrotor in X"
    if share is None:
        if not rotors:
            return None
        return rebuilt, f"{name}: motors of {topic} by {mixer}, which no logged motors check{more}"
    if share < agreement.LEAST_SHARE:
        raise InputError(
            f"{name}: motors are logged at {logged.rate:.3g} Hz, too rarely, "
            f"and {topic} by {mixer} explains {100 * share:.3g} % of their variance; at least "
            f"{100 * agreement.LEAST_SHARE:g} % are needed. {REMEDY}"
        )
    return rebuilt, (
        f"{name}: motors of {topic}, {rebuilt.rate:.0f} Hz, by {mixer}; they explain "
        f"{np.floor(1e4 * share) / 100:.2f} % of the variance of the logged motors "
        f"({logged.rate:.3g} Hz){more}"
    )


def _setpoints(topics: Topics) -> tuple[Stream | None, str]:
    """Torque about x, y, z and thrust along z, forward, right, down; and of which topic."""
    torque = columns(topics, TOPICS[0], *vector("xyz", 3), clock="timestamp_sample")
    thrust = columns(topics, TOPICS[1], "xyz[2]", clock="timestamp_sample")
    if torque is not None and thrust is not None:
        turning, pushing = streams.stream(*torque), streams.stream(*thrust)
        is_finite = np.isfinite(pushing.values[:, 0])
        pushed = streams.between(turning.time, pushing.part(is_finite))
        rows = np.concatenate([turning.values, pushed], axis=1)
        finite = np.isfinite(rows).all(axis=1)
        return Stream(turning.time[finite], rows[finite]), " and ".join(TOPICS[:2])
    controls = columns(topics, TOPICS[2], *vector("control", 4), clock="timestamp_sample")
    if controls is None:
        return None, ""
    stream = streams.stream(controls[0], controls[1] * [1.0, 1.0, 1.0, -1.0])
    sound = np.asarray(np.isfinite(stream.values).all(axis=1))
    return stream.part(sound), TOPICS[2]


def _rotors(parameters: Parameters) -> tuple[Rotor, ...] | None:
    """The rotors that PX4's parameters describe; none where they have no places."""
    usual = {"PX": 0.0, "PY": 0.0, "CT": 6.5, "KM": 0.05}
    rotors = tuple(
        Rotor(*(parameters.get(f"CA_ROTOR{number}_{name}", usual[name]) for name in usual))
        for number in range(4)
    )
    return rotors if any(rotor.forward or rotor.right for rotor in rotors) else None


def _explained(logged: Stream, rebuilt: Stream) -> float | None:
    """Share of the variance of logged motors that turn; none where too few are to compare."""
    if not len(logged.time):
        return None
    near = np.searchsorted(rebuilt.time, logged.time - _TOGETHER)
    near = np.minimum(near, len(rebuilt.time) - 1)
    is_comparable = np.abs(rebuilt.time[near] - logged.time) <= _TOGETHER
    is_comparable &= (np.isfinite(logged.values) & (logged.values > 0)).all(axis=1)
    return agreement.share_explained(
        logged.values[is_comparable], rebuilt.values[near[is_comparable]]
    )
