"""From the messages of an ArduPilot quadrotor to a flight of accelerometer, gyro and motors.

ArduPilot's axes are PX4's, forward, right, down, and turned alike. Motors are logged at 10 Hz
(RCOU), the control's outputs with ATTITUDE_FAST in each loop (RATE): these are mixed as ArduPilot
does where nothing saturates, and what is logged of the motors checks them. A motor's share of
thrust is what ArduPilot takes it for, by MOT_THST_EXPO (e): (1 - e) x + e x^2 of its throttle x
between MOT_SPIN_MIN and MOT_SPIN_MAX.

Source: ArduCopter 3.3, libraries/AP_Motors/AP_MotorsMulticopter.cpp
(apply_thrust_curve_and_volt_scaling), AP_MotorsMatrix.cpp, ArduCopter/Log.cpp (Log_Write_Rate),
libraries/DataFlash/DataFlash.h (CURR); ArduPilot 4.5, libraries/AP_Motors/AP_MotorsMatrix.cpp
(setup_quad_matrix, normalise_rpy_factors, output_armed_stabilizing),
AP_Motors_Thrust_Linearization.cpp, AP_MotorsMulticopter.cpp (output_to_pwm),
libraries/AC_AttitudeControl/LogStructure.h (RATE), AC_AttitudeControl_Logging.cpp,
libraries/AP_InertialSensor (INS_GYRO_FILTER, INS_ACCEL_FILTER), libraries/AP_Logger/AP_Logger.h
(LogEvent), ArduCopter/Copter.cpp (loop_rate_logging, ten_hz_logging_loop).
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from maidenflight.errors import InputError
from maidenflight.flights.checks import airborne
from maidenflight.flights.log import LONGEST_DELAY, Flight
from maidenflight.flights.streams import agreement, joining, rates, streams
from maidenflight.flights.streams.streams import LEFT_UP, Stream

Messages = Mapping[str, Mapping[str, Float[np.ndarray, "M"]]]
"""Fields of messages by their type, such as RATE, or type and sensor, such as IMU[0]."""
Parameters = Mapping[str, float]
_CHANNELS = tuple(f"C{number}" for number in range(1, 15))  # LogStructure.h, RCOU
_OUTPUTS = ("ROut", "POut", "YOut", "AOut")
_TURNS, _FORCES = ("GyrX", "GyrY", "GyrZ"), ("AccX", "AccY", "AccZ")
_TIME = ("TimeUS", "TimeMS")
"""Clock of messages, before ArduCopter 3.3 in ms."""
MESSAGES = {
    "RATE": (*_TIME, "R", "P", "Y", *_OUTPUTS),
    "IMU": (*_TIME, *_TURNS, *_FORCES),
    "RCOU": (*_TIME, *_CHANNELS),
    "ESC": (*_TIME, "RPM"),
    "BAT": (*_TIME, "Volt"),
    "CURR": (*_TIME, "Volt"),
    "EV": (*_TIME, "Id"),
}
"""Messages that are read, and of each the fields: R, P, Y in deg/s, before 3.4 hundredths of that,
gyro in rad/s, accelerometer in m/s^2, channels in us of PWM; volts, before 3.5 hundredths."""
REMEDY = (
    "Add ATTITUDE_FAST (1) and IMU_FAST (262144) to LOG_BITMASK, so that RATE and IMU are logged "
    "in each loop."
)
_QUADROTOR = 1
"""FRAME_CLASS of a quadrotor."""
_ARMED, _DISARMED, _LANDED, _NOT_LANDED = 10, 11, 18, 28
"""Events of EV (AP_Logger.h)."""
_GYRO_HZ, _ACCELEROMETER_HZ = 20.0, 20.0
"""ArduCopter's usual INS_GYRO_FILTER and INS_ACCEL_FILTER, see the source above [Hz]."""
_FIRST_MOTOR = 33
"""SERVOn_FUNCTION of motor 1 (SRV_Channel.h)."""
_OLDEST_S, _SATURATES = 0.06, 0.05
"""Age of outputs that an IO processor reads back every 50 ms (source: AP_IOMCU.cpp) [s], and share
of motors at a limit from which a mixer saturates."""
_DIGITAL = range(4, 8)
"""MOT_PWM_TYPE of DShot (AP_Motors_Class.h): 1000 to 2000 whatever MOT_PWM_MIN and MAX say."""


class Frame(NamedTuple):
    """Where a quadrotor's motors are."""

    order: tuple[int, int, int, int]
    """ArduPilot's number, from 0, of the front right, back right, back left and front left."""
    turns_as_ours: bool = True
    """Whether the front right rotor turns counter-clockwise."""


_FRAMES = {
    1: Frame((0, 3, 1, 2)),
    3: Frame((0, 3, 1, 2), turns_as_ours=False),
    12: Frame((1, 0, 2, 3)),
    13: Frame((0, 3, 2, 1)),
    14: Frame((0, 1, 2, 3)),
    18: Frame((1, 0, 2, 3), turns_as_ours=False),
}
"""By FRAME_TYPE: X, H, Betaflight, DJI, clockwise, reversed Betaflight (AP_Motors_Class.h)."""
_MIX = 0.5 * np.array([[-1, 1, 1], [-1, -1, -1], [1, -1, 1], [1, 1, -1]])
"""Factors of roll, pitch and yaw in our motors' shares of thrust, see the source above; those of
rotors that turn counter-clockwise grow with yaw to the right."""


def flight(
    name: str, messages: Messages, parameters: Parameters
) -> tuple[Flight, Float[np.ndarray, "N"], list[str]]:
    """Returns the flight in what was logged, unchecked.

    Args:
        name: of the file, for errors and notes.
        messages: those of `MESSAGES` that were logged.
        parameters: ArduPilot's.

    Returns:
        The flight, the time of its rows [s] and what was assumed.

    Raises:
        InputError: a signal is missing or logged too rarely, or it is no quadrotor in X.
    """
    frame, frame_notes = _frame(name, parameters)
    sensor = next((key for key in ("IMU[0]", "IMU") if key in messages), "")
    gyro = _stream(messages, sensor, *_TURNS)
    controlled = _stream(messages, "RATE", "R", "P", "Y")
    origin = sensor if gyro.rate >= controlled.rate else "RATE"
    unit = 1e-2 if _is_before_3_4(messages) else 1.0
    turns = gyro.values if origin == sensor else np.radians(unit * controlled.values)
    body_rates = Stream((gyro if origin == sensor else controlled).time, turns * LEFT_UP)
    force = _stream(messages, sensor, *_FORCES)
    delays = [
        min(rates.filter_delay(parameters.get(key, usual)), LONGEST_DELAY)
        for key, usual in (("INS_GYRO_FILTER", _GYRO_HZ), ("INS_ACCEL_FILTER", _ACCELEROMETER_HZ))
    ]
    shares, motor_note = _motors(name, messages, parameters, frame)
    signals = joining.Signals(
        body_rates,
        Stream(shares.time, np.sqrt(shares.values)),
        Stream(force.time, force.values * LEFT_UP),
        rotor_speed=_rotor_speed(messages, frame),
        battery=_battery(messages),
        whole=shares.rate >= 0.8 * parameters.get("SCHED_LOOP_RATE", 400.0),
        accelerometer_delay=delays[1],
        gyro_delay=delays[0],
    )
    logged, time, more_notes = joining.flight(
        name, signals, REMEDY, lambda at: _in_the_air(name, messages, at)
    )
    filters = (
        f"{name}: body rates of {origin}, {body_rates.rate:.0f} Hz; delays of filters that are "
        f"undone: gyro {1e3 * delays[0]:.2g} ms (INS_GYRO_FILTER), accelerometer "
        f"{1e3 * delays[1]:.2g} ms (INS_ACCEL_FILTER)"
    )
    return logged, time, [filters, motor_note, *frame_notes, *more_notes]


def _stream(messages: Messages, key: str, *fields: str) -> Stream:
    """Some fields of a message, with times [s]; without rows if they were not logged."""
    columns = messages.get(key, {})
    if not {"TimeUS", *fields} <= set(columns):
        return Stream(np.zeros(0), np.zeros((0, len(fields))))
    return streams.stream(
        1e-6 * columns["TimeUS"], np.stack([columns[field] for field in fields], axis=1)
    )


def _is_before_3_4(messages: Messages) -> bool:
    """Returns whether RATE is that of ArduCopter before 3.4, with throttle up to 1000, not 1."""
    return bool(np.max(_stream(messages, "RATE", "AOut").values, initial=0.0) > 2.0)


def _battery(messages: Messages) -> Stream | None:
    """The battery's voltage [V], of BAT or the CURR of before 3.7."""
    for key in messages:
        if key.startswith(("BAT", "CURR")):
            volts = _stream(messages, key, "Volt")
            # No small drone has 100 V.
            unit = 1e-2 if np.max(volts.values, initial=0.0) > 100.0 else 1.0
            return volts._replace(values=unit * volts.values)
    return None


def _frame(name: str, parameters: Parameters) -> tuple[Frame, list[str]]:
    """The frame that the parameters describe, and notes on it.

    Raises:
        InputError: it is no quadrotor in X.
    """
    kind, form = (int(parameters.get(key, -1)) for key in ("FRAME_CLASS", "FRAME_TYPE"))
    if kind == form == -1 and "FRAME" in parameters:
        # Firmware of before 3.5 is built for one class, which RATE and RCOU show.
        kind, form = _QUADROTOR, int(parameters["FRAME"])
    if kind != _QUADROTOR or form not in _FRAMES:
        raise InputError(
            f"{name}: its airframe is another (FRAME_CLASS {kind}, FRAME_TYPE {form}; -1 is not "
            "logged); expected a quadrotor in X (1 and one of "
            f"{', '.join(map(str, _FRAMES))}), the frame that logs are read of."
        )
    frame = _FRAMES[form]
    order = ", ".join(str(number + 1) for number in frame.order)
    notes = [f"{name}: quadrotor in X (FRAME_TYPE {form}), ArduPilot's motors {order}"]
    if not frame.turns_as_ours:
        notes.append(joining.note_reversed_rotors(name, f"FRAME_TYPE {form}"))
    return frame, notes


def _motors(
    name: str, messages: Messages, parameters: Parameters, frame: Frame
) -> tuple[Stream, str]:
    """Shares of full thrust of our motors, and how they were read.

    Raises:
        InputError: the motors are logged rarely, and the control's outputs do not explain them.
    """
    expo = parameters.get("MOT_THST_EXPO", 0.65)
    sent = _sent(name, messages, parameters, frame, expo)
    law = f"thrust by the curve of MOT_THST_EXPO = {expo:g}"
    outputs = _stream(messages, "RATE", *_OUTPUTS)
    if sent.rate >= 0.97 * rates.LEAST_HZ or outputs.rate < 0.97 * rates.LEAST_HZ:
        return sent, f"{name}: motors of RCOU; {law}"
    if _is_before_3_4(messages):
        raise InputError(
            f"{name}: a log of ArduCopter before 3.4, whose RATE has outputs of another mixer (up "
            f"to 1000), with motors at {sent.rate:.3g} Hz (RCOU), too rarely: "
            f"{rates.LEAST_HZ:g} Hz are needed. Fly with 3.4 or later."
        )
    yaw = 1.0 if frame.turns_as_ours else -1.0
    torques = outputs.values[:, :3] * [1.0, 1.0, yaw] @ _MIX.T
    mixed = np.clip(outputs.values[:, 3:] + torques, 0.0, None)
    period = streams.period(outputs.time)
    steps = np.arange(round(_OLDEST_S / period) + 1)
    newest = np.searchsorted(outputs.time, sent.time, "right") - 1
    before = mixed[np.clip(newest - steps[:, None], 0, None)]
    compared = (newest >= steps[-1]) & (sent.values > 0).all(axis=1)
    compared &= np.isfinite(before).all(axis=(0, 2))
    logged, before = sent.values[compared], before[:, compared]
    # ArduPilot asks for more in thin air and of an empty battery, by one factor for all.
    gain = float(logged.sum() / max(float(before[0].sum()), 1e-9))
    share, late = agreement.share_explained(logged, gain * before[0]), ""
    if share is not None and share < agreement.LEAST_SHARE:
        # An IO processor's outputs are read back at 20 Hz: all four are of one earlier instant.
        oldest = np.argmin(((gain * before - logged) ** 2).sum(axis=2), axis=0)
        read_back = gain * before[oldest, np.arange(len(logged))]
        share = agreement.share_explained(logged, read_back)
        age = 1e3 * period * float(steps[oldest].mean())
        late = f" as of {age:.0f} ms before, by an IO processor,"
    if share is None or share < agreement.LEAST_SHARE:
        percent = "nothing" if share is None else f"{100 * share:.3g} %"
        limited = float(np.mean([logged >= 0.99, logged <= 0.01])) * 2 if logged.size else 0.0
        raise InputError(
            f"{name}: motors are logged at {sent.rate:.3g} Hz (RCOU), too rarely, and the outputs "
            f"of the control (RATE) explain {percent} of their variance, at whatever time within "
            f"{1e3 * _OLDEST_S:.0f} ms before; at least {100 * agreement.LEAST_SHARE:g} % are "
            f"needed. Motors are at a limit in {limited:.0%} of the rows: "
            + (
                "the mixer saturates. Expected a flight whose motors rarely do."
                if limited > _SATURATES
                else "another mixer, frame or order than the parameters say."
            )
        )
    return Stream(outputs.time, np.clip(gain * mixed, 0.0, 1.0)), (
        f"{name}: motors of RATE by ArduPilot's mixer, {outputs.rate:.0f} Hz; they explain"
        f"{late} {np.floor(1e4 * share) / 100:.2f} % of the variance of the logged motors "
        f"({sent.rate:.3g} Hz), with a factor of {gain:.3g}; {law}"
    )


def _sent(
    name: str, messages: Messages, parameters: Parameters, frame: Frame, expo: float
) -> Stream:
    """Shares of full thrust that the PWM of our motors stands for, by a curve of thrust.

    Raises:
        InputError: motors that spin least and most alike.
    """
    channel = {
        int(parameters.get(f"SERVO{number}_FUNCTION", 0)) - _FIRST_MOTOR: f"C{number}"
        for number in range(1, 15)
    }
    motors = [channel.get(number, f"C{number + 1}") for number in frame.order]
    sent = _stream(messages, "RCOU", *motors)
    low, high = parameters.get("MOT_PWM_MIN", 1000.0), parameters.get("MOT_PWM_MAX", 2000.0)
    if not low < high or int(parameters.get("MOT_PWM_TYPE", 0)) in _DIGITAL:
        low, high = 1000.0, 2000.0
    least, most = parameters.get("MOT_SPIN_MIN", 0.15), parameters.get("MOT_SPIN_MAX", 0.95)
    if "MOT_SPIN_MIN" not in parameters and "THR_MIN" in parameters:
        # Before 3.5 motors begin at a thousandth of the throttle stick's range.
        if not parameters.get("MOT_PWM_MIN"):
            low, high = parameters.get("RC3_MIN", low), parameters.get("RC3_MAX", high)
        low += 1e-3 * parameters["THR_MIN"] * (high - low)
        least, most = 0.0, parameters.get("MOT_THST_MAX", 0.95)
    if not least < most:
        raise InputError(
            f"{name}: MOT_SPIN_MIN {least:g} is not below MOT_SPIN_MAX {most:g}, between which "
            "ArduPilot sends thrust. Its parameters are not those of a drone that flew."
        )
    throttle = np.clip(((sent.values - low) / (high - low) - least) / (most - least), 0.0, 1.0)
    return Stream(sent.time, (1.0 - expo) * throttle + expo * throttle**2)


def _rotor_speed(messages: Messages, frame: Frame) -> Stream | None:
    """Speeds of our motors that ESCs measure [rad/s]; each has times of its own."""
    each = [_stream(messages, f"ESC[{number}]", "RPM") for number in frame.order]
    if min(len(stream.time) for stream in each) < 2 or not any(
        np.any(stream.values) for stream in each
    ):
        return None
    speeds = [streams.between(each[0].time, stream) for stream in each]
    return Stream(each[0].time, np.concatenate(speeds, axis=1) * 2 * np.pi / 60)


def _in_the_air(
    name: str, messages: Messages, at: Float[np.ndarray, "N"]
) -> tuple[Bool[np.ndarray, "N"], list[str]]:
    """Rows in which ArduPilot says that it flies, without those beside the ground."""
    events = _stream(messages, "EV", "Id")
    known = np.isin(events.values[:, 0], (_ARMED, _DISARMED, _LANDED, _NOT_LANDED))
    last = streams.hold_last(at, events.part(known))[:, 0]
    return airborne.leave_out_ground(name, at, np.isfinite(last) & (last != _NOT_LANDED))
