"""Drones of your own to train over: one in four has a weak motor.

In Python by `python examples/own_distribution.py`; on the command line, in this folder, by
`maidenflight train --drone crazyflie --randomize own_distribution:weak_motor`.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

import maidenflight as mf


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class WeakMotor:
    """Drones about one, of which a quarter have a first motor with 5 to 15 % less thrust."""

    centre: mf.Parameters

    def draw(self, key):
        """Returns one drone."""
        which, loss = jax.random.split(key)
        share = jax.random.uniform(loss, minval=0.05, maxval=0.15)
        lost = jnp.where(jax.random.bernoulli(which, 0.25), share, 0.0)
        lift = self.centre.rotor_thrust * jnp.array([1.0 - lost, 1.0, 1.0, 1.0])
        return replace(self.centre, rotor_thrust=lift)


def weak_motor(drone):
    """Makes the distribution of drones about one."""
    return WeakMotor(drone)


if __name__ == "__main__":
    keys, settings = jax.random.split(jax.random.key(0), 1), mf.AnalyticGradient(updates=300)
    drones = weak_motor(mf.crazyflie())
    policies = mf.train(mf.simulator.circle(), mf.simulator.pwm(), drones, keys, settings)
    print(mf.transfer(policies, [mf.reality("virtual:7+weak10")], 3).table)
