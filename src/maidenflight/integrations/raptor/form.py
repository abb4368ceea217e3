"""RAPTOR's form: what policies see and command that programs for RAPTOR fly, in terms of ours.

Such a network has RAPTOR's shape: 22 inputs, 16 values with ReLU, a gated recurrent unit of 16
numbers and, from these alone, four outputs. It sees the position less the set-point (world, clipped
to 0.5 m), the rotation matrix row by row, the velocity less the set-point's (world, clipped to 1
m/s), body rates and its last output. Outputs are rotor speeds a in [-1, 1]: ((a + 1) / 2)^2 of full
thrust.

Its observation of ours has one instant and one point ahead, from which the velocity of the
set-point follows; its action is of PWM control.

Source: Eschmann et al. 2025, RAPTOR; foundation-policy 1.0.2, README and PX4's mc_raptor.
"""

from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from maidenflight.simulator.physics import rotations
from maidenflight.simulator.policy_spec import PolicyForm, require_pwm
from maidenflight.simulator.tasks.look_ahead import LookAhead

RAPTOR = "raptor"
"""Name of the form."""
LOOK_AHEAD = LookAhead(1, 0.01)
"""The set-point one period later."""
MAX_POSITION_ERROR_M = 0.5
MAX_VELOCITY_ERROR_M_S = 1.0
MEAN = np.array([0.0] * 3 + list(np.eye(3).ravel()) + [0.0] * 6 + [0.5] * 4, np.float32)
"""By which a new policy centres the 22 numbers."""
DEVIATION = np.array([0.1] * 3 + [0.2] * 8 + [0.05] + [0.3] * 3 + [1.0] * 3 + [0.3] * 4, np.float32)
"""By which it scales them."""
_LEAST_SHARE = 1e-12
"""Of full thrust, below which the root has no slope; between it and 0 no action of float32 lies."""


def observed(observation: Float[Array, "23"]) -> Float[Array, "22"]:
    """Returns what the network sees of an observation of ours: one instant and a point ahead."""
    _, quaternion, velocity, body_rates, error, action, ahead = jnp.split(
        observation, [3, 7, 10, 13, 16, 20]
    )
    moving = (ahead - error) / LOOK_AHEAD.spacing
    return jnp.concatenate(
        [
            jnp.clip(-error, -MAX_POSITION_ERROR_M, MAX_POSITION_ERROR_M),
            rotations.to_matrix(quaternion).reshape(-1),
            jnp.clip(velocity - moving, -MAX_VELOCITY_ERROR_M_S, MAX_VELOCITY_ERROR_M_S),
            body_rates,
            output_of(action),
        ]
    )


def action_of(output: Float[Array, "4"]) -> Float[Array, "4"]:
    """Returns the action of PWM control that commands an output's rotor speeds.

    What is beyond [-1, 1] stays beyond by as much, and is clipped as any action is.
    """
    speed = jnp.clip(output, -1.0, 1.0)
    return 2.0 * ((speed + 1.0) / 2.0) ** 2 - 1.0 + (output - speed)


def output_of(action: Float[ArrayLike, "4"]) -> Float[Array, "4"]:
    """Returns the output within [-1, 1] that commands what an action does."""
    share = (jnp.clip(jnp.asarray(action), -1.0, 1.0) + 1.0) / 2.0
    # The root's slope at 0 is infinite.
    return 2.0 * jnp.sqrt(jnp.maximum(share, _LEAST_SHARE)) - 1.0


FORM = PolicyForm(
    RAPTOR,
    settled={"history": 1, "look_ahead": LOOK_AHEAD, "memory": 16, "hidden": (16,)},
    inputs=len(MEAN),
    scaling=(MEAN, DEVIATION),
    through_memory=True,
    first_bias=1.0,  # Nothing goes past the 16 values, so none of them begins at 0.
    observed=observed,
    action_of=action_of,
    output_of=output_of,
    check=partial(require_pwm, RAPTOR),
    methods=("gradient", "distillation"),  # Its few values learn little from a teacher.
    learning={"learning_rate": 2e-3},  # They bear no larger steps of their weights.
)
