"""A writer of Betaflight blackbox logs, and flights as Betaflight would log them."""

import numpy as np

ORDER = (1, 0, 2, 3)
"""Betaflight's motors that are our front right, back right, back left, front left."""
HEADERS = {
    "Product": "Blackbox flight data recorder by Nicholas Sherlock",
    "Data version": "2",
    "I interval": "64",
    "P interval": "1/1",
    "Firmware type": "Cleanflight",
    "Firmware revision": "Betaflight 4.5.1 (77d01ba3b) STM32F405",
    "minthrottle": "1070",
    "mincommand": "1000",
    "gyro_scale": "0x3f800000",
    "motorOutput": "158,2047",
    "acc_1G": "2048",
    "vbatcellvoltage": "330,350,430",
    "vbatref": "1650",
    "looptime": "125",
    "pid_process_denom": "16",
    "blackbox_high_resolution": "1",
    "acc_lpf_hz": "0",
    "motor_poles": "14",
    "motor_output_limit": "100",
    "thrust_linear": "0",
    "yaw_motors_reversed": "0",
}


def _unsigned(value):
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def _signed(value):
    return _unsigned((value << 1 ^ value >> 31) & 0xFFFFFFFF)


def _variable(values):
    """TAG2_3SVARIABLE of three numbers, in its smallest form."""
    a, b, c = values
    if all(-2 <= one < 2 for one in values):
        return bytes([(a & 3) << 4 | (b & 3) << 2 | c & 3])
    if -16 <= a < 16 and -16 <= b < 16 and -8 <= c < 8:
        bits = 1 << 14 | (a & 31) << 9 | (b & 31) << 4 | c & 15
        return bits.to_bytes(2, "big")
    if -128 <= a < 128 and -64 <= b < 64 and -64 <= c < 64:
        bits = 2 << 22 | (a & 255) << 14 | (b & 127) << 7 | c & 127
        return bits.to_bytes(3, "big")
    sizes = [
        next(n for n in (1, 2, 3, 4) if -(1 << 8 * n - 1) <= v < 1 << 8 * n - 1) for v in values
    ]
    head = 3 << 6 | sum((size - 1) << 2 * place for place, size in enumerate(sizes))
    return bytes([head]) + b"".join(
        value.to_bytes(size, "little", signed=True)
        for value, size in zip(values, sizes, strict=True)
    )


def blackbox(fields, headers=None, every=64, ended=True):
    """The bytes of one log.

    Fields are written whole in I frames, and in P frames as differences to the frame before, three
    of `axisI` together. Fields: by name, whole numbers of each row; `loopIteration` and `time` [us]
    first, the battery not last.
    """
    names = list(fields)
    rows = np.stack([np.asarray(fields[name], dtype=np.int64) for name in names], axis=1)
    packed = [name.startswith("axisI") for name in names]
    about = {
        "Field I name": names,
        "Field I signed": [int(name not in ("loopIteration", "time")) for name in names],
        "Field I predictor": [0] * len(names),
        "Field I encoding": [1, 1] + [0] * (len(names) - 2),
        "Field P predictor": [6, 2, *[1] * (len(names) - 2)],
        "Field P encoding": [9, 0, *(10 if is_packed else 0 for is_packed in packed[2:])],
    }
    lines = {**HEADERS, **(headers or {})}
    text = [f"{key}:{value}" for key, value in lines.items()]
    text += [f"{key}:{','.join(map(str, values))}" for key, values in about.items()]
    raw = bytearray("".join(f"H {line}\n" for line in text).encode())
    past = past2 = rows[0]
    for number, row in enumerate(rows):
        if number % every == 0:
            raw += b"I" + _unsigned(int(row[0])) + _unsigned(int(row[1]))
            raw += b"".join(_signed(int(value)) for value in row[2:])
            past = past2 = row
            continue
        raw += b"P" + _signed(int(row[1] - (2 * past[1] - past2[1])))
        place = 2
        while place < len(names):
            if packed[place]:
                raw += _variable([int(v) for v in row[place : place + 3] - past[place : place + 3]])
                place += 3
            else:
                raw += _signed(int(row[place] - past[place]))
                place += 1
        past, past2 = row, past
    return bytes(raw + (b"E\xffEnd of log\0" if ended else b""))


def fields_of(flight, order=ORDER, start=5_000_000, low=48, high=2047, battery=True):
    """Fields of one of our flights, as Betaflight would fill them.

    Args:
        flight: with an accelerometer.
        order: Betaflight's number of our motors 1 to 4.
        start: time of the first row [us].
        low: output of a motor that does not turn.
        high: greatest output.
        battery: whether it is logged.
    """
    rows = len(flight)
    found = {
        "loopIteration": np.arange(rows),
        "time": start + np.round(np.arange(rows) * flight.period * 1e6).astype(int),
    }
    for axis in range(3):
        found[f"axisI[{axis}]"] = np.round(300 * np.sin(np.arange(rows) * 0.3 * (axis + 1) ** 4))
    if battery:
        found["vbatLatest"] = np.round(100 * flight.battery)
    for axis in range(3):
        found[f"gyroADC[{axis}]"] = np.round(10 * np.degrees(flight.body_rates[:, axis]))
    for axis in range(3):
        found[f"accSmooth[{axis}]"] = np.round(2048 * flight.accelerometer[:, axis] / 9.81)
    motors = np.zeros((rows, 4))
    motors[:, list(order)] = np.round(low + (high - low) * np.sqrt(flight.command))
    found |= {f"motor[{motor}]": motors[:, motor] for motor in range(4)}
    if flight.rotor_speed is not None:
        turns = np.zeros((rows, 4))
        turns[:, list(order)] = flight.rotor_speed * 60 / (2 * np.pi) * 7 / 100
        found |= {f"eRPM[{motor}]": np.round(turns[:, motor]) for motor in range(4)}
    return found
