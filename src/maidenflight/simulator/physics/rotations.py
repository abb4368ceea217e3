"""Attitude as unit quaternions (x, y, z, w), body to world, and as roll, pitch, yaw.

The angles are intrinsic ZYX: R = Rz Ry Rx. World: z up. Body: x forward, y left, z up. Positive
pitch is nose down.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from maidenflight.simulator.physics.vectors import like, norm

_PI: Any = np.float32(np.pi)
_EIGHTH: Any = np.float32(np.tan(np.pi / 8))
_ARCTAN: tuple[Any, ...] = tuple(
    map(np.float32, (8.05374449538e-2, -1.38776856032e-1, 1.99777106478e-1, -3.33329491539e-1))
)
"""Coefficients of t^9, t^7, t^5 and t^3 in arctan t."""


def axes(quaternion: Float[Array, "4"]) -> tuple[tuple[Float[Array, ""], ...], ...]:
    """Returns the body's x, y and z axes in the world: the columns of the rotation matrix."""
    x, y, z, w = quaternion
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


def to_matrix(quaternion: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """Returns the rotation matrix R of a unit quaternion: world = R body."""
    return jnp.stack([jnp.stack(axis) for axis in axes(quaternion)], axis=1)


def body_z(quaternion: Float[Array, "4"]) -> Float[Array, "3"]:
    """Returns the body's z axis in the world: the last column of the rotation matrix."""
    return jnp.stack(axes(quaternion)[2])


def to_attitude(quaternion: Float[Array, "4"]) -> Float[Array, "3"]:
    """Returns roll, pitch, yaw [rad] of a unit quaternion; pitch in [-pi/2, pi/2]."""
    x, y, z, w = quaternion
    left, up = 2 * (w * x + y * z), 1 - 2 * (x * x + y * y)
    pitch = arctan2(2 * (w * y - z * x), norm((left, up)))
    return like(quaternion, [arctan2(left, up), pitch, heading(quaternion)])


def heading(quaternion: Float[Array, "4"]) -> Float[Array, ""]:
    """Returns the yaw [rad] of a unit quaternion."""
    x, y, z, w = quaternion
    return arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


@jax.custom_jvp
def arctan2(y: Float[Array, "..."], x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Returns the angle of the point (x, y) from the x axis [rad], in [-pi, pi] and to 3e-7.

    A loop over many takes a tenth of the time of XLA's own, which calls the C library for each.

    Source: Moshier, Cephes mathematical library, atanf.c: the polynomial, and the reduction of
    slopes above tan(pi / 8).
    """
    across, along = jnp.abs(y), jnp.abs(x)
    least, most = jnp.minimum(across, along), jnp.maximum(across, along)
    slope = least / jnp.where(most == 0, 1.0, most)
    steep = slope > _EIGHTH
    t = jnp.where(steep, (slope - 1) / (slope + 1), slope)
    square, series = t * t, _ARCTAN[0]
    for coefficient in _ARCTAN[1:]:
        series = series * square + coefficient
    angle = t + t * square * series + jnp.where(steep, _PI / 4, 0.0)
    angle = jnp.where(across > along, _PI / 2 - angle, angle)
    angle = jnp.where(x < 0, _PI - angle, angle)
    return jnp.where(y < 0, -angle, angle)


@arctan2.defjvp
def _arctan2_jvp(point: tuple[Array, Array], change: tuple[Array, Array]) -> tuple[Array, Array]:
    (y, x), (dy, dx) = point, change
    return arctan2(y, x), (x * dy - y * dx) / (x * x + y * y)


def from_attitude(attitude: Float[Array, "3"]) -> Float[Array, "4"]:
    """Returns the unit quaternion of roll, pitch, yaw [rad]."""
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


def product(first: Float[Array, "4"], other: Float[Array, "4"]) -> Float[Array, "4"]:
    """Returns the quaternion of two rotations, the other in the axes that the first has turned."""
    vector = first[3] * other[:3] + other[3] * first[:3] + jnp.cross(first[:3], other[:3])
    return jnp.concatenate([vector, (first[3] * other[3] - first[:3] @ other[:3])[None]])


def turn_heading(quaternion: Float[Array, "4"], angle: Float[Array, ""]) -> Float[Array, "4"]:
    """Returns the attitude turned about the world's z axis by an angle [rad]."""
    none = jnp.zeros_like(angle)
    return product(from_attitude(jnp.stack([none, none, angle])), quaternion)


def quaternion_derivative(
    quaternion: Float[Array, "4"], body_rates: Float[Array, "3"]
) -> Float[Array, "4"]:
    """Returns dq/dt = q (x) (omega, 0) / 2 for body rates omega [rad/s]."""
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
    """Returns the unit quaternion of the same direction."""
    x, y, z, w = quaternion
    return quaternion * lax.rsqrt(x * x + y * y + z * z + w * w)
