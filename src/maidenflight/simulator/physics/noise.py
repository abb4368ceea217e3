"""Standard normal and uniform random numbers of a step from one draw.

Many small draws would take longer than the physics.
"""

import jax
import numpy as np
from jax import lax
from jaxtyping import Array, Float


def draw(
    key: Array, normals: int, uniforms: int
) -> tuple[Float[Array, "normals"], Float[Array, "uniforms"]]:
    """Draws independent random numbers.

    Args:
        key: random key.
        normals: how many of the standard normal distribution; the inverse error function of uniform
            ones, as in JAX.
        uniforms: how many of the uniform distribution on [-1, 1).
    """
    least = np.nextafter(np.float32(-1.0), np.float32(0.0))
    numbers = jax.random.uniform(key, (normals + uniforms,), minval=least, maxval=1.0)
    return np.float32(np.sqrt(2)) * lax.erf_inv(numbers[:normals]), numbers[normals:]
