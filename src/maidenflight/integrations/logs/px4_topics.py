"""Topics of a PX4 drone as a recording holds them, and what makes it record them more often."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

Topics = Mapping[str, Mapping[str, np.ndarray]]
"""Fields of each topic by the names that ULog gives them, such as `control[0]`; `timestamp` and
`timestamp_sample` in us."""
Parameters = Mapping[str, float]

GYRO_CUTOFF = 40.0
"""PX4's usual low-pass filter of body rates, IMU_GYRO_CUTOFF [Hz] (imu_gyro_parameters.c)."""
REMEDY = (
    "Set SDLOG_PROFILE to 17 (default set and high rate) and reboot, so that sensor_combined and "
    "actuator_motors are logged at full rate."
)


def columns(
    topics: Topics, topic: str, *fields: str, clock: str = "timestamp"
) -> tuple[Float[np.ndarray, "M"], Float[np.ndarray, "M K"]] | None:
    """Times [s] and some fields of a topic, if it has them all."""
    rows = topics.get(topic)
    if rows is None or not {"timestamp", *fields} <= set(rows):
        return None
    stamps = rows["timestamp"].astype(float)
    sampled = rows.get(clock)
    if sampled is not None:
        stamps = np.where(sampled > 0, sampled.astype(float), stamps)
    return stamps * 1e-6, np.stack([rows[field].astype(float) for field in fields], axis=1)


def middle_of(time: Float[np.ndarray, "M"], span: Float[np.ndarray, "M"]) -> Float[np.ndarray, "M"]:
    """Returns the middle [s] of integrations that end at some times [s] after a span [us]."""
    return time - np.clip(np.nan_to_num(span), 0.0, 2e4) * 0.5e-6


def vector(field: str, count: int) -> tuple[str, ...]:
    """Returns the names of the elements of a field."""
    return tuple(f"{field}[{number}]" for number in range(count))
