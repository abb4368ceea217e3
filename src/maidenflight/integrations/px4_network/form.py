"""The form of PX4's `mc_nn_control`: what its network sees and gives, in terms of ours.

It sees 15 numbers: set-point less position (world), the first two rows of the rotation matrix,
velocity (world) and body rates. PX4 turns them into axes that are ours: x forward, y left, z up,
the world's x to the east. It sees neither its last action nor the past.

An output a in [-1, 1] becomes c = 0.8 x^2 + 0.2 x with x = sqrt((a + 1) / 2), where the motors'
range is set as `export` writes it. PX4 takes c for a share of full thrust, if THR_MDL_FAC is that
of the motors, as `maidenflight drone --to px4` writes it.

Source: PX4-Autopilot, src/modules/mc_nn_control (PopulateInputTensor; actions_rescale.hpp).
"""

from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from maidenflight.simulator.physics import rotations
from maidenflight.simulator.policy_spec import PolicyForm, require_pwm
from maidenflight.simulator.tasks.look_ahead import LookAhead

PX4 = "px4"
"""Name of the form, and of its exporter."""
BEND = 0.8
"""Of the curve from x to c, by the firmware."""
MEAN = np.array([0.0] * 3 + [1, 0, 0, 0, 1, 0] + [0.0] * 6, np.float32)
"""By which a new policy centres the 15 numbers, chosen."""
DEVIATION = np.array([0.1] * 3 + [0.2] * 6 + [0.3] * 3 + [1.0] * 3, np.float32)
"""By which it scales them, chosen as RAPTOR's form has them."""
_LEAST_SHARE = 1e-12
"""Below which the root has no slope; chosen below what float32 resolves."""


def observed(observation: Float[Array, "20"]) -> Float[Array, "15"]:
    """Returns what the network sees of an observation of ours, of one instant."""
    _, quaternion, velocity, body_rates, error, _ = jnp.split(observation, [3, 7, 10, 13, 16])
    rows = rotations.to_matrix(quaternion)[:2].reshape(-1)
    return jnp.concatenate([error, rows, velocity, body_rates])


def action_of(output: Float[Array, "4"]) -> Float[Array, "4"]:
    """Returns the action of PWM control that commands what PX4 makes of an output.

    What is beyond [-1, 1] stays beyond by as much, and is clipped as any action is.
    """
    clipped = jnp.clip(output, -1.0, 1.0)
    square = jnp.maximum((clipped + 1.0) / 2.0, _LEAST_SHARE)
    share = BEND * square + (1.0 - BEND) * jnp.sqrt(square)
    return 2.0 * share - 1.0 + (output - clipped)


def output_of(action: Float[ArrayLike, "4"]) -> Float[Array, "4"]:
    """Returns the output within [-1, 1] that commands what an action does."""
    share = (jnp.clip(jnp.asarray(action), -1.0, 1.0) + 1.0) / 2.0
    linear = 1.0 - BEND
    root = (jnp.sqrt(linear**2 + 4.0 * BEND * share) - linear) / (2.0 * BEND)
    return 2.0 * root**2 - 1.0


FORM = PolicyForm(
    PX4,
    settled={"history": 1, "look_ahead": LookAhead(), "memory": 0, "hidden": (64, 64)},
    inputs=len(MEAN),
    scaling=(MEAN, DEVIATION),
    observed=observed,
    action_of=action_of,
    output_of=output_of,
    check=partial(require_pwm, PX4),
    methods=("gradient", "ppo"),
)
"""Layers are chosen: those of any size below the module's memory are in its firmware's reach."""
