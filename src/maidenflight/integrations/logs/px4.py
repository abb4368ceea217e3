"""From the topics of a PX4 drone to a flight, whatever recorded them.

PX4's world is north, east, down and its body forward, right, down. Ours is north, west, up and
forward, left, up: of both, x stays and y and z are turned, so that yaw is 0 with the nose to the
north and one matrix D = diag(1, -1, -1) serves all; a rotation R becomes D R D, a quaternion
(w, x, y, z) becomes (w, x, -y, -z).

`joining` makes the rows. `sensor_combined` comes first, since `vehicle_angular_velocity` and
`vehicle_acceleration` are low-pass filtered; its values are means over an integration time, so they
belong to its middle.

Source: PX4 v1.14, src/modules/logger/logged_topics.cpp (rates, SDLOG_PROFILE), msg/*.msg (units,
frames), src/modules/land_detector/land_detector_params_mc.c.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from maidenflight.errors import InputError
from maidenflight.flights.checks import airborne
from maidenflight.flights.log import LONGEST_DELAY, Flight
from maidenflight.flights.streams import joining, rates, streams
from maidenflight.flights.streams.streams import LEFT_UP, Stream
from maidenflight.integrations.logs import px4_motors, px4_setpoints
from maidenflight.integrations.logs.px4_topics import (
    GYRO_CUTOFF,
    REMEDY,
    Parameters,
    Topics,
    columns,
    middle_of,
    vector,
)

TOPICS = (
    "vehicle_local_position",
    "vehicle_attitude",
    "vehicle_angular_velocity",
    "vehicle_acceleration",
    "sensor_combined",
    "actuator_motors",
    "actuator_outputs",
    *px4_setpoints.TOPICS,
    "esc_status",
    "battery_status",
    "vehicle_land_detected",
    "vehicle_status",
)
"""Topics that are read."""
ARMED = 2
"""State of a vehicle whose motors run (PX4, vehicle_status.msg: ARMING_STATE_ARMED)."""
FULL_RATE = 0.8
"""Share of the control loop's rate from which a log holds every command."""
ACCELEROMETER_CUTOFF = 30.0
"""PX4's usual low-pass filter of accelerations, IMU_ACCEL_CUTOFF [Hz] (imu_accel_parameters.c)."""
_INVALID = 2**31 - 1  # Source: PX4, msg/SensorCombined.msg, RELATIVE_TIMESTAMP_INVALID.


def flight(
    name: str, topics: Topics, parameters: Parameters
) -> tuple[Flight, Float[np.ndarray, "N"], list[str]]:
    """Returns the flight in what was recorded, unchecked.

    Args:
        name: of the file, for errors and notes.
        topics: those of `TOPICS` that were recorded.
        parameters: PX4's, as far as they were recorded.

    Returns:
        The flight, the time of its rows [s] and what was assumed.

    Raises:
        InputError: a signal is missing or logged too rarely, or it is no quadrotor in X or never
            armed.
    """
    px4_motors.check_airframe(name, parameters)
    status = columns(topics, "vehicle_status", "arming_state")
    if status is not None and not np.any(status[1] == ARMED):
        raise InputError(f"{name}: never armed. Leave it out.")
    body_rates, gyro_delay, gyro_notes = _gyro(name, topics, parameters)
    force, force_delay = _force(topics, parameters)
    rotors = px4_motors.rotors(name, parameters)
    speeds, motor_notes = px4_motors.motors(name, topics, parameters, rotors.order)
    state, state_notes = _state(name, topics)
    loop = float(parameters.get("IMU_GYRO_RATEMAX", 400.0)) or 400.0
    signals = joining.Signals(
        body_rates,
        speeds,
        force,
        state,
        px4_motors.rotor_speed(topics, rotors.order),
        _battery(topics),
        speeds.rate >= FULL_RATE * loop,
        force_delay,
        gyro_delay,
    )
    logged, time, more_notes = joining.flight(
        name, signals, REMEDY, lambda at: _in_the_air(name, topics, at)
    )
    logged = replace(logged, square_since=px4_motors.square_since(parameters))
    return logged, time, [*gyro_notes, *motor_notes, *rotors.notes, *state_notes, *more_notes]


def _gyro(name: str, topics: Topics, parameters: Parameters) -> tuple[Stream, float, list[str]]:
    """Body rates, forward, left, up, and the delay of their filter [s]."""
    raw = columns(topics, "sensor_combined", *vector("gyro_rad", 3), "gyro_integral_dt")
    filtered = columns(
        topics, "vehicle_angular_velocity", *vector("xyz", 3), clock="timestamp_sample"
    )
    empty = Stream(np.zeros(0), np.zeros((0, 3)))
    first = empty if raw is None else _centred(*raw)
    second = empty if filtered is None else streams.stream(filtered[0], filtered[1] * LEFT_UP)
    if first.rate >= rates.LEAST_HZ or first.rate >= second.rate:
        return first, 0.0, [f"{name}: body rates of sensor_combined, {first.rate:.0f} Hz"]
    delay = min(rates.filter_delay(parameters.get("IMU_GYRO_CUTOFF", GYRO_CUTOFF)), LONGEST_DELAY)
    note = (
        f"{name}: body rates of vehicle_angular_velocity, {second.rate:.0f} Hz, behind PX4's "
        f"low-pass filter (IMU_GYRO_CUTOFF), whose delay of {1e3 * delay:.2g} ms is undone"
    )
    return second, delay, [note]


def _centred(time: np.ndarray, values: np.ndarray) -> Stream:
    """Means over an integration time [us], the last column, in its middle."""
    return streams.stream(middle_of(time, values[:, 3]), values[:, :3] * LEFT_UP)


def _force(topics: Topics, parameters: Parameters) -> tuple[Stream | None, float]:
    """Specific force, forward, left, up, unfiltered if logged, and its filter's delay [s]."""
    fields = *vector("accelerometer_m_s2", 3), "accelerometer_integral_dt"
    raw = columns(topics, "sensor_combined", *fields)
    if raw is not None:
        relative = topics["sensor_combined"].get("accelerometer_timestamp_relative")
        late = np.zeros(len(raw[0])) if relative is None else relative.astype(float)
        is_valid = late != _INVALID
        return _centred(np.where(is_valid, raw[0] + late * 1e-6, np.nan), raw[1]), 0.0
    filtered = columns(topics, "vehicle_acceleration", *vector("xyz", 3), clock="timestamp_sample")
    if filtered is None:
        return None, 0.0
    delay = rates.filter_delay(parameters.get("IMU_ACCEL_CUTOFF", ACCELEROMETER_CUTOFF))
    return streams.stream(filtered[0], filtered[1] * LEFT_UP), min(delay, LONGEST_DELAY)


def _state(name: str, topics: Topics) -> tuple[Stream | None, list[str]]:
    """Position, velocity and attitude, or none where they are not known often enough."""
    numbers = "x", "y", "z", "vx", "vy", "vz"
    position = columns(topics, "vehicle_local_position", *numbers, clock="timestamp_sample")
    turned = columns(topics, "vehicle_attitude", *vector("q", 4), clock="timestamp_sample")
    if position is None or turned is None:
        lacking = "position" if position is None else "attitude"
        return None, [f"{name}: no {lacking} logged: {joining.ALONE}"]
    fields = topics["vehicle_local_position"]
    names = "xy_valid", "z_valid", "v_xy_valid", "v_z_valid"
    flags = [fields[flag].astype(bool) for flag in names if flag in fields]
    valid = np.all(flags, axis=0) if flags else np.ones(len(position[0]), bool)
    if valid.mean() < 0.5:
        share = 100 * (1 - valid.mean())
        return None, [f"{name}: PX4 has no valid position in {share:.0f} %: {joining.ALONE}"]
    moved = np.concatenate([position[1][:, :3] * LEFT_UP, position[1][:, 3:] * LEFT_UP], axis=1)
    place_stream = streams.stream(position[0], np.where(valid[:, None], moved, np.nan))
    quaternion = turned[1][:, [1, 2, 3, 0]] * [1.0, -1.0, -1.0, 1.0]
    series, notes = joining.state(name, place_stream, streams.stream(turned[0], quaternion))
    if series is not None:
        notes = [f"{name}: position, velocity and attitude of PX4's estimator, x north, z up"]
    return series, notes


def _in_the_air(
    name: str, topics: Topics, at: Float[np.ndarray, "N"]
) -> tuple[Bool[np.ndarray, "N"], list[str]]:
    """Rows in which PX4 says that it flies, without those beside the ground."""
    ground = np.zeros(len(at), bool)
    landed = columns(topics, "vehicle_land_detected", "landed")
    if landed is not None:
        ground |= streams.hold_last(at, streams.stream(*landed))[:, 0] > 0
    status = columns(topics, "vehicle_status", "arming_state")
    if status is not None:
        state = streams.hold_last(at, streams.stream(*status))[:, 0]
        ground |= np.isfinite(state) & (state != ARMED)
    return airborne.leave_out_ground(name, at, ground)


def _battery(topics: Topics) -> Stream | None:
    series = columns(topics, "battery_status", "voltage_v")
    return None if series is None else streams.stream(*series)
