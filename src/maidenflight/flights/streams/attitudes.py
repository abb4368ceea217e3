"""Roll, pitch and yaw of quaternions, and angles between the rows of a log."""

import warnings

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


def of_quaternions(values: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N 3"]:
    """Returns roll, pitch, yaw [rad] of quaternions x, y, z, w; NaN where one is none."""
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.linalg.norm(values, axis=1)
    sound = np.isfinite(values).all(axis=1) & (norm > 0.5) & (norm < 1e6)
    attitude = np.full((len(values), 3), np.nan)
    with warnings.catch_warnings():
        # Nose straight up, roll and yaw cannot be told apart; such rows are dropped as a crash.
        warnings.filterwarnings("ignore", "Gimbal lock")
        attitude[sound] = Rotation.from_quat(values[sound]).as_euler("ZYX")[:, ::-1]
    return attitude


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Angles [rad] in [-pi, pi)."""
    return np.remainder(angle + np.pi, 2 * np.pi) - np.pi
