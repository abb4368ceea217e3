"""A writer of PX4 ULog files, and flights as PX4 would log them."""

import struct

import numpy as np

ORDER = (0, 3, 1, 2)
"""PX4's motors that are our front right, back right, back left, front left."""
CORNERS = {1: (0.1, 0.1), 2: (-0.1, -0.1), 3: (0.1, -0.1), 4: (-0.1, 0.1)}
"""Places of PX4's motors, forward and right [m]."""
SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
LETTERS = {"uint64_t": "Q", "float": "f", "int32_t": "i", "uint32_t": "I", "bool": "?"}
LETTERS |= {"uint8_t": "B", "uint16_t": "H"}


def _message(kind, payload):
    return struct.pack("<HB", len(payload), ord(kind)) + payload


def _keyed(kind, typed, name, value):
    key = f"{typed} {name}".encode()
    return _message(
        kind, struct.pack("<B", len(key)) + key + struct.pack("<" + LETTERS[typed], value)
    )


def ulog(topics, parameters=None):
    """The bytes of a ULog.

    Args:
        topics: by name, a list of (field, type, values of the samples), `timestamp` [us] first;
            values of several columns are an array.
        parameters: by name; whole numbers are written as such.
    """
    raw = bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))
    raw += _message("B", bytes(8 + 8 + 24))
    records = []
    for number, (name, fields) in enumerate(topics.items()):
        columns = [np.asarray(values) for _, _, values in fields]
        written = [
            typed if values.ndim == 1 else f"{typed}[{values.shape[1]}]"
            for (_, typed, _), values in zip(fields, columns, strict=True)
        ]
        described = ";".join(
            f"{typed} {field}" for typed, (field, _, _) in zip(written, fields, strict=True)
        )
        raw += _message("F", f"{name}:{described};".encode())
        letters = "".join(
            f"{1 if values.ndim == 1 else values.shape[1]}{LETTERS[typed]}"
            for (_, typed, _), values in zip(fields, columns, strict=True)
        )
        for row in range(len(columns[0])):
            numbers = [one for values in columns for one in np.atleast_1d(values[row]).tolist()]
            payload = struct.pack(f"<H{letters}", number, *numbers)
            records.append((int(columns[0][row]), _message("D", payload)))
    for key, value in (parameters or {}).items():
        raw += _keyed("P", "int32_t" if isinstance(value, int) else "float", key, value)
    for number, name in enumerate(topics):
        raw += _message("A", struct.pack("<BH", 0, number) + name.encode())
    records.sort(key=lambda entry: entry[0])
    for place, (_, record) in enumerate(records):
        raw += record if place % 100 else _message("S", SYNC) + record
    return bytes(raw)


def placed(corners=CORNERS, turns=(0.05, 0.05, -0.05, -0.05)):
    """Parameters of a quadrotor with its motors at some places."""
    found: dict[str, float] = {"CA_ROTOR_COUNT": len(corners), "IMU_GYRO_RATEMAX": 400}
    for motor, (forward, right) in corners.items():
        found[f"CA_ROTOR{motor - 1}_PX"] = float(forward)
        found[f"CA_ROTOR{motor - 1}_PY"] = float(right)
        found[f"CA_ROTOR{motor - 1}_KM"] = float(turns[motor - 1])
    return found


def topics_of(flight, order=ORDER, start=10_000_000, state=True, thrust=np.sqrt, integral=0):
    """Topics of one of our flights, as PX4 would fill them.

    Args:
        flight: to be written.
        order: PX4's number of our motors 1 to 4.
        start: time of the first row [us].
        state: whether position and attitude are logged.
        thrust: from u to what `actuator_motors` holds.
        integral: time over which the gyro was averaged [us]; 0 for none.
    """
    rows = len(flight)
    stamps = (start + np.round(np.arange(rows) * flight.period * 1e6)).astype(np.int64)
    turn = np.array([1.0, -1.0, -1.0])
    force = flight.accelerometer
    force = np.tile([0.0, 0.0, 9.81], (rows, 1)) if force is None else force
    control = np.zeros((rows, 4))
    control[:, list(order)] = thrust(flight.command)
    topics = {
        "sensor_combined": [
            ("timestamp", "uint64_t", stamps + integral // 2),
            ("gyro_rad", "float", flight.body_rates * turn),
            ("gyro_integral_dt", "uint32_t", np.full(rows, integral)),
            ("accelerometer_timestamp_relative", "int32_t", np.zeros(rows, int)),
            ("accelerometer_m_s2", "float", force * turn),
            ("accelerometer_integral_dt", "uint32_t", np.full(rows, integral)),
        ],
        "actuator_motors": [
            ("timestamp", "uint64_t", stamps),
            ("control", "float", control),
        ],
        "battery_status": [
            ("timestamp", "uint64_t", stamps[::20]),
            ("voltage_v", "float", flight.battery[::20]),
        ],
    }
    if flight.rotor_speed is not None:
        turns = np.zeros((rows, 4))
        turns[:, list(order)] = flight.rotor_speed * 60 / (2 * np.pi)
        topics["esc_status"] = [
            ("timestamp", "uint64_t", stamps),
            *((f"esc[{esc}].esc_rpm", "int32_t", turns[:, esc].astype(int)) for esc in range(4)),
        ]
    if state:
        valid = [(flag, "bool", np.ones(rows, bool)) for flag in VALID]
        moved = np.concatenate([flight.position * turn, flight.velocity * turn], axis=1)
        topics["vehicle_local_position"] = [
            ("timestamp", "uint64_t", stamps + 300),
            ("timestamp_sample", "uint64_t", stamps),
            *(
                (field, "float", moved[:, column])
                for column, field in enumerate(("x", "y", "z", "vx", "vy", "vz"))
            ),
            *valid,
        ]
        topics["vehicle_attitude"] = [
            ("timestamp", "uint64_t", stamps + 200),
            ("timestamp_sample", "uint64_t", stamps),
            ("q", "float", quaternions(flight.attitude)),
        ]
    return topics


def by_default_profile(topics, motors=10, setpoints=1):
    """The same topics with motors logged rarely, and torque and thrust set-points beside them.

    Set-points are solved from the motors, in the quadrotor in X of `placed`.

    Args:
        topics: see `topics_of`.
        motors: of so many rows one is logged.
        setpoints: likewise.
    """
    stamps, control = (values for _, _, values in topics["actuator_motors"])
    half = np.sqrt(0.5)
    by_axis = np.array(
        [[-half, half, 1, -1], [half, -half, 1, -1], [half, half, -1, -1], [-half, -half, -1, -1]]
    )
    asked = np.linalg.solve(by_axis, control.T).T
    down = np.concatenate([np.zeros((len(asked), 2)), asked[:, 3:]], axis=1)

    def topic(name, values, every):
        timed = [("timestamp", "uint64_t", stamps + 90), ("timestamp_sample", "uint64_t", stamps)]
        return [(*one, rows[::every]) for *one, rows in [*timed, (name, "float", values)]]

    return topics | {
        "vehicle_torque_setpoint": topic("xyz", asked[:, :3], setpoints),
        "vehicle_thrust_setpoint": topic("xyz", down, setpoints),
        "actuator_motors": topic("control", control, motors),
    }


VALID = ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")


def quaternions(attitude):
    """(w, x, y, z) from the FRD body to NED, of our roll, pitch and yaw, from half angles."""
    roll, pitch, yaw = (attitude * [1.0, -1.0, -1.0]).T / 2
    cr, sr, cp, sp, cy, sy = (
        function(angle) for angle in (roll, pitch, yaw) for function in (np.cos, np.sin)
    )
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )
