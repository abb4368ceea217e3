"""`Gru`, a gated recurrent unit: what a policy remembers of its flight, and how.

Source: Cho et al. 2014, "Learning Phrase Representations using RNN Encoder-Decoder"; the reset gate
acts behind the product with the memory, as in cuDNN, PyTorch, ONNX (`linear_before_reset`) and
RL-tools.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_GATES = 3


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Gru:
    """Weights of a gated recurrent unit of M numbers over I inputs.

    Rows are those of the reset gate, of the update gate and of the candidate, M each.
    """

    weights: Float[Array, "3M I"]
    """Of the inputs."""
    recurrent: Float[Array, "3M M"]
    """Of the memory."""
    biases: Float[Array, "3M"]
    """Of the inputs."""
    recurrent_biases: Float[Array, "3M"]
    """Of the memory; those of the candidate are scaled by the reset gate."""

    @property
    def size(self) -> int:
        """M."""
        return self.recurrent.shape[-1]

    def __call__(self, values: Float[Array, "I"], memory: Float[Array, "M"]) -> Float[Array, "M"]:
        """The memory after one more input; within [-1, 1] if it was."""
        inputs = jnp.split(self.weights @ values + self.biases, _GATES)
        memory_gates = jnp.split(self.recurrent @ memory + self.recurrent_biases, _GATES)
        reset = jax.nn.sigmoid(inputs[0] + memory_gates[0])
        update = jax.nn.sigmoid(inputs[1] + memory_gates[1])
        candidate = jnp.tanh(inputs[2] + reset * memory_gates[2])
        return (1.0 - update) * candidate + update * memory

    def shapes_for(self, inputs: int) -> dict[str, tuple[tuple[int, ...], tuple[int, ...]]]:
        """Compares each field's shape with the one that it should have over so many inputs."""
        rows = _GATES * self.size
        expected = {
            "weights": (rows, inputs),
            "recurrent": (rows, self.size),
            "biases": (rows,),
            "recurrent_biases": (rows,),
        }
        return {name: (np.shape(getattr(self, name)), shape) for name, shape in expected.items()}


def untrained_gru(key: Array, inputs: int, size: int) -> Gru:
    """Returns a unit that keeps most of its memory from one period to the next.

    Weights are uniform within 1 / sqrt(M), as PyTorch's; the update gate's bias is 2.

    Args:
        key: random key.
        inputs: I.
        size: M.
    """
    bound = np.float32(1.0 / np.sqrt(size))
    first, second = jax.random.split(key)
    rows = _GATES * size
    biases = np.zeros(rows, np.float32)
    biases[size : 2 * size] = 2.0
    return Gru(
        jax.random.uniform(first, (rows, inputs), minval=-bound, maxval=bound),
        jax.random.uniform(second, (rows, size), minval=-bound, maxval=bound),
        jnp.asarray(biases),
        jnp.zeros(rows),
    )
