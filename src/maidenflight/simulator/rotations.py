"""Attitude as unit quaternions (x, y, z, w), body to world, and as roll, pitch, yaw.

The angles are intrinsic ZYX: R = Rz Ry Rx. World: z up. Body: x forward, y left, z up. Positive
pitch is nose down.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from maidenflight.simulator.vectors import like


def axes(quaternion: Float[Array, "4"]) -> tuple[tuple[Float[Array, ""], ...], ...]:
    """The body's x, y and z axes in the world: the columns of the rotation matrix."""
    x, y, z, w = quaternion
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


def to_matrix(quaternion: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """Rotation matrix R of a unit quaternion: world = R body."""
    return jnp.stack([jnp.stack(axis) for axis in axes(quaternion)], axis=1)


def body_z(quaternion: Float[Array, "4"]) -> Float[Array, "3"]:
    """The body's z axis in the world: the last column of the rotation matrix."""
    return jnp.stack(axes(quaternion)[2])


def to_attitude(quaternion: Float[Array, "4"]) -> Float[Array, "3"]:
    """Roll, pitch, yaw [rad] of a unit quaternion; pitch in [-pi/2, pi/2]."""
    x, y, z, w = quaternion
    roll = jnp.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = jnp.arcsin(jnp.clip(2 * (w * y - z * x), -1.0, 1.0))
    return like(quaternion, [roll, pitch, heading(quaternion)])


def heading(quaternion: Float[Array, "4"]) -> Float[Array, ""]:
    """Yaw [rad] of a unit quaternion."""
    x, y, z, w = quaternion
    return jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def from_attitude(attitude: Float[Array, "3"]) -> Float[Array, "4"]:
    """Unit quaternion of roll, pitch, yaw [rad]."""
    sin_r, sin_p, sin_y = jnp.sin(attitude / 2)
    cos_r, cos_p, cos_y = jnp.cos(attitude / 2)
    return jnp.stack(
        [
            sin_r * cos_p * cos_y - cos_r * sin_p * sin_y,
            cos_r * sin_p * cos_y + sin_r * cos_p * sin_y,
            cos_r * cos_p * sin_y - sin_r * sin_p * cos_y,
            cos_r * cos_p * cos_y + sin_r * sin_p * sin_y,
        ]
    )


def quaternion_derivative(
    quaternion: Float[Array, "4"], body_rates: Float[Array, "3"]
) -> Float[Array, "4"]:
    """dq/dt = q (x) (omega, 0) / 2 for body rates omega [rad/s]."""
    x, y, z, w = quaternion
    p, q, r = body_rates
    return 0.5 * like(
        quaternion,
        [
            w * p + y * r - z * q,
            w * q + z * p - x * r,
            w * r + x * q - y * p,
            -x * p - y * q - z * r,
        ],
    )


def normalise(quaternion: Float[Array, "4"]) -> Float[Array, "4"]:
    """The unit quaternion of the same direction."""
    x, y, z, w = quaternion
    return quaternion * lax.rsqrt(x * x + y * y + z * z + w * w)
