"""Recordings of ROS 2, written by rosbags' own writer, of our flights."""

import numpy as np
from made_ulogs import ORDER, topics_of
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORAGES = {".mcap": StoragePlugin.MCAP, ".db3": StoragePlugin.SQLITE3}
NANO = 1_000_000_000
START = 1_700_000_000
"""Of recordings [s]."""
PX4 = {
    "SensorCombined": "uint64 timestamp\nfloat32[3] gyro_rad\nuint32 gyro_integral_dt\n"
    "int32 accelerometer_timestamp_relative\nfloat32[3] accelerometer_m_s2\n"
    "uint32 accelerometer_integral_dt\n",
    "ActuatorMotors": "uint64 timestamp\nuint64 timestamp_sample\nfloat32[12] control\n",
    "VehicleAttitude": "uint64 timestamp\nuint64 timestamp_sample\nfloat32[4] q\n",
    "VehicleLocalPosition": "uint64 timestamp\nuint64 timestamp_sample\n"
    + "".join(f"bool {flag}\n" for flag in ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid"))
    + "".join(f"float32 {field}\n" for field in ("x", "y", "z", "vx", "vy", "vz")),
    "BatteryStatus": "uint64 timestamp\nfloat32 voltage_v\n",
}
"""Those fields of px4_msgs that matter here."""
OTHERS = {
    "mavros_msgs/msg/RCOut": "std_msgs/Header header\nuint16[] channels\n",
    "crazyflie_interfaces/msg/LogDataGeneric": "std_msgs/Header header\nuint32 timestamp\n"
    "float32[] values\n",
    "mine/msg/Motors": "float64[4] share\n",
}


def store():
    """Types of all messages that are written here."""
    found = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in PX4.items():
        found.register(get_types_from_msg(text, f"px4_msgs/msg/{name}"))
    for name, text in OTHERS.items():
        found.register(get_types_from_msg(text, name))
    return found


TYPES = store()


def bag(folder, messages, suffix=".mcap"):
    """Writes a bag and gives its file.

    Args:
        folder: of the bag; it must not be there.
        messages: (time [s], topic, message) in any order.
        suffix: of its storage.
    """
    with Writer(folder, version=9, storage_plugin=STORAGES[suffix]) as writer:
        connections = {}
        for time, topic, message in sorted(messages, key=lambda entry: entry[0]):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            raw = TYPES.serialize_cdr(message, kind)
            writer.write(connections[topic], round(time * NANO), raw)
    return next(folder.glob(f"*{suffix}"))


def message(kind, **fields):
    """A message with a header where its type has one; `time` [s] is the header's."""
    made = TYPES.types[kind]
    if "time" in fields:
        seconds, nano = divmod(round(fields.pop("time") * NANO), NANO)
        stamp = TYPES.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nano)
        fields["header"] = TYPES.types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    return made(**fields)


def px4_messages(flight, mark="", **how):
    """Messages of px4_msgs; see `made_ulogs.topics_of`."""
    names = {
        "sensor_combined": "SensorCombined",
        "actuator_motors": "ActuatorMotors",
        "vehicle_attitude": "VehicleAttitude",
        "vehicle_local_position": "VehicleLocalPosition",
        "battery_status": "BatteryStatus",
    }
    for topic, fields in topics_of(flight, **how).items():
        if topic not in names:
            continue
        kind = f"px4_msgs/msg/{names[topic]}"
        wanted = [name for name, _ in TYPES.fielddefs[kind][1]]
        columns = {field: np.asarray(values) for field, _, values in fields}
        if topic == "actuator_motors":
            rest = np.full((len(columns["control"]), 8), np.nan)
            columns["control"] = np.concatenate([columns["control"], rest], axis=1)
        columns.setdefault("timestamp_sample", np.zeros(len(columns["timestamp"]), int))
        for row, stamp in enumerate(columns["timestamp"]):
            values = {name: columns[name][row] for name in wanted}
            made = {
                name: value.astype(np.float32) if value.ndim else value.item()
                for name, value in values.items()
            }
            # Received later than measured.
            yield START + stamp * 1e-6 + 0.02, f"{mark}/fmu/out/{topic}", message(kind, **made)


def vector(values):
    return TYPES.types["geometry_msgs/msg/Vector3"](*map(float, values))


def point(values):
    return TYPES.types["geometry_msgs/msg/Point"](*map(float, values))


def quaternion(roll, pitch, yaw):
    """Of our angles, from half of each."""
    cr, sr, cp, sp, cy, sy = (
        function(angle / 2) for angle in (roll, pitch, yaw) for function in (np.cos, np.sin)
    )
    made = TYPES.types["geometry_msgs/msg/Quaternion"]
    return made(
        x=float(sr * cp * cy - cr * sp * sy),
        y=float(cr * sp * cy + sr * cp * sy),
        z=float(cr * cp * sy - sr * sp * cy),
        w=float(cr * cp * cy + sr * sp * sy),
    )


def imu(time, rates, force, turn):
    return message(
        "sensor_msgs/msg/Imu",
        time=time,
        orientation=turn,
        orientation_covariance=np.zeros(9),
        angular_velocity=vector(rates),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(force),
        linear_acceleration_covariance=np.zeros(9),
    )


def mavros_messages(flight, mark="", order=ORDER):
    """Messages of MAVROS in our axes, each received 10 ms late."""
    for row in range(len(flight)):
        time = START + row * flight.period
        turn = quaternion(*flight.attitude[row])
        sensed = imu(time, flight.body_rates[row], flight.accelerometer[row], turn)
        yield time + 0.01, f"{mark}/mavros/imu/data", sensed
        channels = np.zeros(8, np.uint16)
        channels[list(order)] = np.round(1000 + 1000 * np.sqrt(flight.command[row]))
        out = message("mavros_msgs/msg/RCOut", time=time, channels=channels)
        yield time + 0.01, f"{mark}/mavros/rc/out", out
        pose = TYPES.types["geometry_msgs/msg/Pose"](point(flight.position[row]), turn)
        yield (
            time + 0.01,
            f"{mark}/mavros/local_position/pose",
            message("geometry_msgs/msg/PoseStamped", time=time, pose=pose),
        )
        moves = TYPES.types["geometry_msgs/msg/Twist"](
            vector(flight.velocity[row]), vector(np.zeros(3))
        )
        yield (
            time + 0.01,
            f"{mark}/mavros/local_position/velocity_local",
            message("geometry_msgs/msg/TwistStamped", time=time, twist=moves),
        )
