"""A writer of ArduPilot DataFlash files, and flights as ArduPilot would log them."""

import struct

import numpy as np

SIZES = {"Q": 8, "f": 4, "B": 1, "H": 2, "N": 16}
PLACES = {1: (0, 3, 1, 2), 12: (1, 0, 2, 3), 13: (0, 3, 2, 1), 14: (0, 1, 2, 3)}
"""ArduPilot's numbers of our motors by FRAME_TYPE, written down once more for the reader's test:
X numbers front right, back left, front left, back right."""
PARAMETERS = {
    **{"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0, "INS_GYRO_FILTER": 0.0, "INS_ACCEL_FILTER": 0.0},
    **{"MOT_THST_EXPO": 0.5, "MOT_SPIN_MIN": 0.15, "MOT_SPIN_MAX": 0.95, "SCHED_LOOP_RATE": 100.0},
    **{"MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0},
}


def dataflash(messages, parameters):
    """The bytes of a log.

    Args:
        messages: (type, fields with commas, letters of their types, rows of values), each with
            `TimeUS` first.
        parameters: by name.
    """
    kinds = [
        ("PARM", "TimeUS,Name,Value", "QNf", [(0, k.encode(), v) for k, v in parameters.items()])
    ]
    kinds += messages
    raw = _format(0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)
    records = []
    for number, (name, fields, letters, rows) in enumerate(kinds, 1):
        codes = "<" + letters.replace("N", "16s")
        raw += _format(number, name, letters, fields, 3 + struct.calcsize(codes))
        head = struct.pack("BBB", 0xA3, 0x95, number)
        records += [(row[0], head + struct.pack(codes, *row)) for row in rows]
    records.sort(key=lambda entry: entry[0])
    return raw + b"".join(record for _, record in records)


def _format(number, name, letters, fields, length):
    packed = struct.pack(
        "<BB4s16s64s", number, length, name.encode(), letters.encode(), fields.encode()
    )
    return struct.pack("BBB", 0xA3, 0x95, 0x80) + packed


def messages_of(flight, form=1, rare=10, gain=1.0, start=5_000_000):
    """Messages of one of our flights.

    Args:
        flight: with an accelerometer.
        form: FRAME_TYPE.
        rare: of so many rows the motors of one are logged.
        gain: factor by which ArduPilot asks for more than its control's outputs.
        start: time of the first row [us].
    """
    stamps = (start + np.round(np.arange(len(flight)) * flight.period * 1e6)).astype(int)
    turn = np.array([1.0, -1.0, -1.0])
    gyro, force = flight.body_rates * turn, flight.accelerometer * turn
    thrust = flight.command.astype(float)
    front_right, back_right, back_left, front_left = thrust.T / gain
    # A motor's thrust is the mean plus half of each output; so sums over corners give them.
    outputs = np.stack([
        (back_left + front_left - front_right - back_right) / 2,
        (front_right + front_left - back_right - back_left) / 2,
        (front_right + back_left - back_right - front_left) / 2,
        thrust.mean(axis=1) / gain,
    ], axis=1)  # fmt: skip
    sent = np.zeros((len(flight), 14))
    # thrust = (1 - e) x + e x^2 with e = 0.5
    throttle = -0.5 + np.sqrt(0.25 + 2 * thrust)
    sent[:, list(PLACES[form])] = 1000 + 1000 * (0.15 + 0.8 * throttle)
    rows = range(len(flight))
    messages = [
        ("RATE", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut", "Qffffffffffff", [
            (stamps[n], *np.ravel([(0.0, np.degrees(gyro[n, k]), outputs[n, k]) for k in range(3)]),
             0.0, 0.0, outputs[n, 3]) for n in rows]),
        ("IMU", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", "QBffffff", [
            (stamps[n] + other, other, *(gyro[n] + other), *(force[n] + other))
            for n in rows for other in (0, 1)]),
        ("RCOU", "TimeUS," + ",".join(f"C{n}" for n in range(1, 15)), "Q" + "H" * 14, [
            (stamps[n], *np.round(sent[n]).astype(int)) for n in rows[::rare]]),
        ("BAT", "TimeUS,Inst,Volt", "QBf", [
            (stamps[n], 0, flight.battery[n]) for n in rows[::20]]),
    ]  # fmt: skip
    if flight.rotor_speed is not None:
        turns = np.zeros((len(flight), 4))
        turns[:, list(PLACES[form])] = flight.rotor_speed * 60 / (2 * np.pi)
        each = [(stamps[n], esc, turns[n, esc]) for n in rows for esc in range(4)]
        messages.append(("ESC", "TimeUS,Instance,RPM", "QBf", each))
    return messages
