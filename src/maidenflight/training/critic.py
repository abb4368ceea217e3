"""PPO's critic: its network, generalised advantage estimation, and running moments."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from maidenflight.training.devices import DRONES

SMALLEST_DEVIATION = 1e-5
"""Added to standard deviations before dividing by them (authors' code)."""


class Moments(NamedTuple):
    """Mean and variance of all samples so far."""

    samples: Float[Array, ""]
    """How many samples."""
    mean: Float[Array, "..."]
    variance: Float[Array, "..."]

    @property
    def deviation(self) -> Float[Array, "..."]:
        """Standard deviation, never 0."""
        return jnp.sqrt(self.variance) + SMALLEST_DEVIATION


class Critic(NamedTuple):
    """A network that predicts the scaled discounted return."""

    weights: tuple[Float[Array, "outputs inputs"], ...]
    biases: tuple[Float[Array, "outputs"], ...]

    def __call__(self, observation: Float[Array, "S"]) -> Float[Array, ""]:
        """Value of a normalised observation."""
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            observation = jnp.tanh(weight @ observation + bias)
        return (self.weights[-1] @ observation + self.biases[-1])[0]


def untrained_critic(key: Array, sizes: tuple[int, ...]) -> Critic:
    """Draws Kaiming-uniform weights and zero biases.

    Source: Gronauer et al. 2022, sec. Zero-Shot Experiments.
    """

    def layer(key: Array, inputs: int, outputs: int) -> Array:
        bound = np.float32(np.sqrt(6.0 / inputs))
        return jax.random.uniform(key, (outputs, inputs), minval=-bound, maxval=bound)

    weights = tuple(map(layer, jax.random.split(key, len(sizes) - 1), sizes[:-1], sizes[1:]))
    return Critic(weights, tuple(jnp.zeros(size) for size in sizes[1:]))


def advantages(
    rewards: Float[Array, "T"],
    values: Float[Array, "T"],
    values_after: Float[Array, "T"],
    terminated: Bool[Array, "T"],
    truncated: Bool[Array, "T"],
    discount: float,
    gae_lambda: float,
) -> Float[Array, "T"]:
    """Estimates generalised advantages over T successive actions.

    Args:
        rewards: of each period.
        values: the critic's values before each.
        values_after: and after each, before a reset.
        terminated: whether the drone failed; the return after it is 0.
        truncated: whether the time limit was reached; the critic's value stands for the return
            after it.
        discount: gamma.
        gae_lambda: lambda.

    Source: Schulman et al. 2016, eq. 16; truncation as in Pardo et al. 2018.
    """
    surprises = rewards + discount * jnp.where(terminated, 0.0, values_after) - values

    def accumulate(
        later: Float[Array, ""], now: tuple[Array, Array]
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        surprise, over = now
        advantage = surprise + discount * gae_lambda * jnp.where(over, 0.0, later)
        return advantage, advantage

    return lax.scan(accumulate, jnp.zeros(()), (surprises, terminated | truncated), reverse=True)[1]


def moments_of(samples: Float[Array, "n ..."]) -> Moments:
    """Computes moments of the samples of all devices."""
    mean = lax.pmean(jnp.mean(samples, axis=0), DRONES)
    variance = lax.pmean(jnp.mean((samples - mean[None]) ** 2, axis=0), DRONES)
    return Moments(
        jnp.asarray(samples.shape[0] * lax.axis_size(DRONES), jnp.float32), mean, variance
    )


def merged(first: Moments, other: Moments) -> Moments:
    """Moments of the samples of both. Source: Chan, Golub and LeVeque 1983, eq. 2.1."""
    count = first.samples + other.samples
    share, step = other.samples / count, other.mean - first.mean
    variance = (
        (1.0 - share) * first.variance + share * other.variance + share * (1.0 - share) * step**2
    )
    return Moments(count, first.mean + share * step, variance)


def value_of(moments: Moments, critic: Critic, observation: Float[Array, "S"]) -> Float[Array, ""]:
    """Returns the value of an observation that is not yet normalised."""
    return critic((observation - moments.mean) / moments.deviation)
