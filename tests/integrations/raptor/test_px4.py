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


def test_the_archive_holds_each_table_with_its_shape_as_the_module_reads_it() -> None:
    policy = made()
    content = px4.to_archive(policy, "policy_1", 3)
    assert content == px4.to_archive(policy, "policy_1", 3)
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        entries = {
            entry.name: archive.extractfile(entry).read()  # pyright: ignore
            for entry in archive.getmembers()
        }
    for offset in range(0, 512 * 3, 512):
        if content[offset : offset + 5] == b"actor":
            assert content[offset + 257 : offset + 262] == b"ustar"

    def table(path: str) -> np.ndarray:
        told = dict(line.split(": ", 1) for line in entries[f"{path}/meta"].decode().splitlines())
        assert told["dtype"] == "float32"
        assert len(entries[f"{path}/meta"]) < 100
        sizes = ["rows", "cols"]
        if told["type"] == "tensor":
            sizes = [f"dim_{axis}" for axis in range(int(told["num_dims"]))]
        shape = [int(told[size]) for size in sizes]
        return np.frombuffer(entries[f"{path}/data"], "<f4").reshape(shape)

    for number, (_, _, tables) in enumerate(layers_of(policy)):
        for name, numbers in tables.items():
            found = table(f"actor/layers/{number}/{name}/parameters")
            np.testing.assert_array_equal(found, numbers)
    for found, numbers in zip(
        map(table, ("example/input", "example/output")), example(policy, 3), strict=True
    ):
        np.testing.assert_array_equal(found, numbers)
    meta = entries["actor/meta"].decode()
    assert "\ncheckpoint_name: policy_1\n" in meta
    assert len(meta) < 256
    with pytest.raises(InputError, match="too long a name for PX4"):
        px4.to_archive(policy, 99 * "x")


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
