"""A learner of your own: optax and the gradient of the distance, by the public simulator alone.

Run with `python examples/own_learner.py`; the policy is ours, so that it can be exported.
"""

import jax
import jax.numpy as jnp
import optax

import maidenflight as mf

DRONES, STEPS = 64, 150


def learn(key, updates=400):
    """Returns a policy for the paper's circle by PWM, and its mean distance by update [m]."""
    drone = mf.crazyflie()
    env = mf.simulator.Environment.matching(drone)
    start = mf.untrained_policy(key)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(3e-3))

    def distance(network, key):
        policy, state = start.with_network(network), mf.simulator.reset(env, drone, key)
        _, (_, result) = mf.simulator.rollout(env, policy, state, drone, key, STEPS)
        return jnp.mean(result.position_error)

    def cost(network, keys):
        return jnp.mean(jax.vmap(distance, (None, 0))(network, keys))

    def update(learner, key):
        network, state = learner
        value, gradient = jax.value_and_grad(cost)(network, jax.random.split(key, DRONES))
        changes, state = optimiser.update(gradient, state)
        return (optax.apply_updates(network, changes), state), value

    learner = start.network, optimiser.init(start.network)
    keys = jax.random.split(key, updates)
    (network, _), distances = jax.jit(lambda: jax.lax.scan(update, learner, keys))()
    return start.with_network(network), distances


if __name__ == "__main__":
    policy, distances = learn(jax.random.key(0))
    print(f"distance {distances[0]:.2f} m at first, {distances[-1]:.2f} m at last")
    print(mf.transfer([policy], [mf.virtual_drone(7)], 3).table)
