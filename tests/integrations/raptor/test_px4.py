"""The archive for PX4's module holds the checkpoint; commands reach the motors that are meant."""

import io
import tarfile

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.integrations.raptor import px4
from maidenflight.integrations.raptor.checkpoint import example, layers_of
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator.policy_spec import PolicySpec


def made() -> Policy:
    one = untrained_policy(jax.random.key(0), spec=PolicySpec(form="raptor"))
    weights, (first, last), gru = one.network
    return one.with_network(
        ((weights[0], 8.0 * weights[1]), (first + 0.3, last + jnp.array([0.1, 0.2, 0.3, 0.4])), gru)
    )


BLOCK = 512
GRU = {
    "weights_input": (48, 16),
    "biases_input": (48,),
    "weights_hidden": (48, 16),
    "biases_hidden": (48,),
    "initial_hidden_state": (16,),
}
SHAPES = {
    **{f"actor/layers/0/{name}": size for name, size in (("weights", (16, 22)), ("biases", (16,)))},
    **{f"actor/layers/1/{name}": size for name, size in GRU.items()},
    **{f"actor/layers/2/{name}": size for name, size in (("weights", (4, 16)), ("biases", (4,)))},
}
"""Tables that PX4's module asks for, with the sizes that its network is compiled with."""


class RLTools:
    """A reader as RL-tools' `persist/backends/tar` is documented: it ends at the first surprise."""

    def __init__(self, content: bytes) -> None:
        self.content, self.asked = content, set[str]()

    def entry(self, name: str) -> bytes:
        """Walks through the headers from the first: 512 bytes each, sizes octal, data padded."""
        place = 0
        while place <= len(self.content) - BLOCK:
            header = self.content[place : place + BLOCK]
            if header[0] == 0:
                break
            assert header[257:262] == b"ustar"
            size = int(header[124:136].split(b"\0")[0], 8)
            place += BLOCK
            if header[:100].split(b"\0")[0] == name.encode():
                self.asked.add(name)
                return self.content[place : place + size]
            place += -(-size // BLOCK) * BLOCK
        raise AssertionError(f"{name} is missing")

    def tensor(self, path: str, shape: tuple[int, ...]) -> np.ndarray:
        """Refuses what is no tensor of float32 of that shape; a meta is at most 99 characters."""
        meta = self.entry(f"{path}/meta")
        assert len(meta) < 100
        assert meta.endswith(b"\n")
        told = dict(line.split(": ") for line in meta.decode().splitlines())
        sizes = {f"dim_{axis}": str(size) for axis, size in enumerate(shape)}
        assert told.pop("type") == "tensor"
        assert told.pop("dtype") == "float32"
        assert told.pop("num_dims") == str(len(shape))
        assert told == sizes
        data = self.entry(f"{path}/data")
        assert len(data) == 4 * np.prod(shape)
        return np.frombuffer(data, "<f4").reshape(shape)


def test_rl_tools_loads_every_table_as_a_tensor_of_the_size_it_is_compiled_with() -> None:
    policy = made()
    content = px4.to_archive(policy, "policy_1", 3)
    assert content == px4.to_archive(policy, "policy_1", 3)
    reader = RLTools(content)
    read = {name: reader.tensor(f"{name}/parameters", size) for name, size in SHAPES.items()}
    for number, (kind, activation, tables) in enumerate(layers_of(policy)):
        lines = reader.entry(f"actor/layers/{number}/meta").decode().splitlines()
        assert f"type: {kind}" in lines
        assert not activation or f"activation_function: {activation}" in lines
        for name, numbers in tables.items():
            np.testing.assert_array_equal(read[f"actor/layers/{number}/{name}"], numbers.squeeze())
    inputs, outputs = (
        reader.tensor(f"example/{what}", (100, 2, size))
        for what, size in (("input", 22), ("output", 4))
    )
    expected = example(policy, 3)
    np.testing.assert_array_equal(inputs, expected[0])
    np.testing.assert_array_equal(outputs, expected[1])
    meta = reader.entry("actor/meta").decode()
    assert "\ncheckpoint_name: policy_1\n" in meta
    assert len(meta) < 256
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        assert {entry.name for entry in archive.getmembers()} == reader.asked
    with pytest.raises(InputError, match="too long a name for PX4"):
        px4.to_archive(policy, 99 * "x")


def test_what_is_read_computes_the_example_as_the_module_does_when_it_starts() -> None:
    """In float32, over the first five instants; it refuses a mean difference of 1e-5."""
    reader = RLTools(px4.to_archive(made(), "policy_1", 3))
    read = {name: reader.tensor(f"{name}/parameters", size) for name, size in SHAPES.items()}
    first, unit, last = (
        {name.rsplit("/", 1)[1]: table for name, table in read.items() if f"/{layer}/" in name}
        for layer in range(3)
    )
    memory = np.stack([unit["initial_hidden_state"]] * 2)
    inputs = reader.tensor("example/input", (100, 2, 22))
    outputs = reader.tensor("example/output", (100, 2, 4))

    def half(numbers: np.ndarray) -> np.ndarray:
        return np.float32(1.0) / (np.float32(1.0) + np.exp(-numbers))

    for step in range(5):
        values = np.maximum(inputs[step] @ first["weights"].T + first["biases"], 0.0)
        a, b, c = np.split(values @ unit["weights_input"].T + unit["biases_input"], 3, axis=1)
        d, e, f = np.split(memory @ unit["weights_hidden"].T + unit["biases_hidden"], 3, axis=1)
        memory = (1 - half(b + e)) * np.tanh(c + half(a + d) * f) + half(b + e) * memory
        action = memory @ last["weights"].T + last["biases"]
        np.testing.assert_allclose(action, outputs[step], atol=2e-6)


def test_outputs_go_to_px4_s_motors_from_idle_at_0_to_full_at_1() -> None:
    """Ours: front right, back right, back left, front left. PX4's Quadrotor X: front right, back
    left, front left, back right."""
    outputs = np.array([-1.0, -0.5, 0.0, 1.0])
    np.testing.assert_array_equal(px4.controls_of(outputs), [0.0, 0.5, 1.0, 0.25])
    assert px4.controls_of(np.full(4, -1.1)).max() < 0.0


def test_the_table_of_commands_is_what_the_network_gives_first() -> None:
    lines = px4.commands(made()).splitlines()
    assert lines[0] == "state,control_0,control_1,control_2,control_3"
    assert [line.split(",")[0] for line in lines[1:]] == list(px4.STATES)
    found = np.array([[float(cell) for cell in line.split(",")[1:]] for line in lines[1:]])
    assert len(np.unique(found.round(4), axis=0)) == len(found)
    policy = made()
    seen = jnp.concatenate([jnp.zeros(3), jnp.eye(3).ravel(), jnp.zeros(10)])
    weights, biases = (jnp.asarray(one) for one in layers_of(policy)[0][2].values())
    values = jnp.maximum(weights @ seen + biases[0], 0.0)
    memory = policy.gru(values, jnp.zeros(16))  # pyright: ignore
    output = policy.weights[1] @ memory + policy.biases[1]
    np.testing.assert_allclose(found[0], px4.controls_of(np.asarray(output)), atol=1e-4)
