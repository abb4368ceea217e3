"""A network of your own: tanh instead of ReLU, trained by gradients through the simulator.

Run with `python examples/own_network.py`. Files and exports hold networks of ours alone.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

import maidenflight as mf


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class TanhPolicy(mf.Policy):
    """A policy whose layers end in tanh."""

    def __call__(self, observation):
        """Returns the action for an observation."""
        values = (observation - self.observation_mean) / self.observation_std
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            values = jnp.tanh(weight @ values + bias)
        return self.weights[-1] @ values + self.biases[-1]


if __name__ == "__main__":
    start = TanhPolicy(**vars(mf.untrained_policy(jax.random.key(1))))
    policies = mf.train(
        mf.simulator.circle(),
        mf.simulator.pwm(),
        mf.simulator.relative_box(mf.crazyflie(), 0.1),
        jax.random.split(jax.random.key(0), 1),
        mf.AnalyticGradient(updates=300),
        start,
    )
    print(mf.transfer(policies, [mf.virtual_drone(7)], 3).table)
