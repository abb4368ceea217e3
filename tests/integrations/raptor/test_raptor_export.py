"""Programs for RAPTOR fly a policy of its form as we do, from the file alone."""

import dataclasses
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight import __version__, cli, policy_file
from maidenflight.deployment import export
from maidenflight.deployment.check import check_export
from maidenflight.errors import InputError
from maidenflight.integrations.raptor.checkpoint import to_raptor
from maidenflight.integrations.raptor.export import export_raptor
from maidenflight.integrations.raptor.foundation_policy import observed
from maidenflight.parameters import crazyflie
from maidenflight.policy import Actor, Policy, untrained_policy
from maidenflight.registry import EXPORTERS
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.controllers import control
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks import tasks

h5py: Any = pytest.importorskip("h5py")
Evaluate = Callable[[np.ndarray], np.ndarray]
"""What a reader does with the 22 numbers of one instant."""


def made() -> Policy:
    """A policy whose rotor speeds differ, some beyond their range."""
    one = untrained_policy(jax.random.key(0), spec=PolicySpec(form="raptor"))
    weights, (first, last), gru = one.network
    return one.with_network(
        ((weights[0], 8.0 * weights[1]), (first + 0.3, last + jnp.array([0.4, 0.5, 0.6, 0.7])), gru)
    )


def read_in_numpy(path: Path) -> Evaluate:
    """A reader of these checkpoints, in float64."""

    def table(group: Any, name: str) -> np.ndarray:
        return np.asarray(group[name]["parameters"], np.float64)

    def half(numbers: np.ndarray) -> np.ndarray:
        return 1.0 / (1.0 + np.exp(-numbers))

    with h5py.File(path) as file:
        first, unit, last = (file["actor/layers"][str(number)] for number in range(3))
        dense = [(table(layer, "weights"), table(layer, "biases")[0]) for layer in (first, last)]
        given = table(unit, "weights_input"), table(unit, "biases_input")
        known = table(unit, "weights_hidden"), table(unit, "biases_hidden")
        memory = table(unit, "initial_hidden_state")

    def evaluate(seen: np.ndarray) -> np.ndarray:
        nonlocal memory
        values = np.maximum(dense[0][0] @ seen + dense[0][1], 0.0)
        a, b, c = np.split(given[0] @ values + given[1], 3)
        d, e, f = np.split(known[0] @ memory + known[1], 3)
        memory = (1 - half(b + e)) * np.tanh(c + half(a + d) * f) + half(b + e) * memory
        return dense[1][0] @ memory + dense[1][1]

    return evaluate


def read_by_its_makers(path: Path) -> Evaluate:
    """The reader of foundation-policy, which also checks the example."""
    package: Any = pytest.importorskip("foundation_policy", reason="not installed (extra [raptor])")
    network = package.load(path)
    assert network.meta["environment"]["name"] == "l2f"
    network.reset()
    return lambda seen: network.evaluate_step(seen[None])[0]


@pytest.mark.slow
@pytest.mark.parametrize("read", [read_in_numpy, read_by_its_makers])
def test_a_reader_commands_what_we_command_in_flight(
    read: Callable[[Path], Evaluate], tmp_path: Path
) -> None:
    """The observations are those of our flight, converted by what flies RAPTOR itself."""
    one, drone, task = made(), crazyflie(), tasks.circle()
    path, *_ = export_raptor(one, tmp_path)
    evaluate, hover = read(path), float(dynamics.hover_command(drone))
    env = Environment.matching(
        drone,
        task,
        control.pwm(),
        spec=one.spec,
    )
    step = jax.jit(lambda state, output, key: stepping.step(env, state, output, drone, key)[0])
    state = environment.reset(env, drone, jax.random.key(1))
    actor, last = Actor(one, hover), np.full(4, 2.0 * np.sqrt(hover) - 1.0)
    beyond = 0
    for key in jax.random.split(jax.random.key(2), 60):
        now, later = (np.asarray(task.reference(state.time + d)) for d in (0.0, 0.01))
        act = actor.act(state.measurement, now, later[None])
        seen = Measurement(*(np.asarray(part, np.float64) for part in state.measurement))  # pyright: ignore
        last = evaluate(observed(seen, now, (later.astype(float) - now) / 0.01, last))
        share = ((np.clip(last, -1.0, 1.0) + 1.0) / 2.0) ** 2
        np.testing.assert_allclose(act.command, share, rtol=0, atol=1e-5)
        beyond += np.sum(np.abs(last) > 1.0)
        memory = jnp.zeros(one.spec.memory)
        state = step(state, jnp.concatenate([jnp.asarray(act.action), memory]), key)
    assert beyond > 0


def test_the_file_is_laid_out_as_raptors_own(tmp_path: Path) -> None:
    one = made()
    path, *_ = export(one, tmp_path, "raptor", name="mine", seed=3, record={"seed": 3}, hover=0.5)
    assert path == tmp_path / "policy.h5"
    with h5py.File(path) as file:
        shapes = {}
        file.visititems(
            lambda name, each: shapes.update({name: each.shape} if hasattr(each, "shape") else {})
        )
        assert shapes == {
            "actor/layers/0/weights/parameters": (16, 22),
            "actor/layers/0/biases/parameters": (1, 16),
            "actor/layers/1/weights_input/parameters": (48, 16),
            "actor/layers/1/biases_input/parameters": (48,),
            "actor/layers/1/weights_hidden/parameters": (48, 16),
            "actor/layers/1/biases_hidden/parameters": (48,),
            "actor/layers/1/initial_hidden_state/parameters": (16,),
            "actor/layers/2/weights/parameters": (4, 16),
            "actor/layers/2/biases/parameters": (1, 4),
            "example/input": (100, 2, 22),
            "example/output": (100, 2, 4),
        }
        assert all(file[name].dtype == np.float32 for name in shapes)
        layers = [dict(file[f"actor/layers/{number}"].attrs) for number in range(3)]
        assert layers == [
            {"type": "dense", "activation_function": "RELU"},
            {"type": "gru"},
            {"type": "dense", "activation_function": "IDENTITY"},
        ]
        actor = dict(file["actor"].attrs)
        assert (actor["type"], actor["checkpoint_name"]) == ("sequential", "mine")
        assert json.loads(actor["meta"])["environment"]["observation"].startswith("Position.Orient")
        told = {name: dict(file[name].attrs) for name in shapes}
        matrix = {"type": "matrix", "rows": "16", "cols": "22"}
        assert told["actor/layers/0/weights/parameters"] == matrix
        tensor = {"type": "tensor", "num_dims": "2", "dim_0": "48", "dim_1": "16"}
        assert told["actor/layers/1/weights_hidden/parameters"] == tensor
        how = json.loads(file.attrs["maidenflight"])
        assert how == {
            "version": __version__,
            "sha256": hashlib.sha256(policy_file.to_json(one).encode()).hexdigest(),
            "record": {"seed": 3},
        }


def test_the_example_is_what_a_reader_computes(tmp_path: Path) -> None:
    path, *_ = export_raptor(made(), tmp_path, seed=5)
    with h5py.File(path) as file:
        seen, outputs = (np.asarray(file[f"example/{name}"]) for name in ("input", "output"))
    for number in range(seen.shape[1]):
        evaluate = read_in_numpy(path)
        found = np.stack([evaluate(one) for one in seen[:, number].astype(np.float64)])
        np.testing.assert_allclose(outputs[:, number], found, rtol=0, atol=1e-5)
    np.testing.assert_allclose(seen[1:, :, 18:], np.clip(outputs[:-1], -1.0, 1.0), atol=1e-6)
    turned = seen[..., 3:12].reshape(-1, 3, 3)
    np.testing.assert_allclose(
        turned @ turned.swapaxes(1, 2), np.tile(np.eye(3), (200, 1, 1)), atol=1e-6
    )


def test_the_same_policy_seed_and_record_give_the_same_bytes() -> None:
    one = made()
    same = to_raptor(one, "mine", 1, {"seed": 1})
    assert same == to_raptor(one, "mine", 1, {"seed": 1})
    assert same != to_raptor(one, "mine", 2, {"seed": 1})


def test_a_file_of_the_form_reads_back_bit_by_bit_and_others_do_not_name_it(tmp_path: Path) -> None:
    one = made()
    back = policy_file.read_policy(policy_file.write_policy(tmp_path / "policy.json", one)).policy
    assert jax.tree.structure(back) == jax.tree.structure(one)
    for old, new in zip(jax.tree.leaves(one), jax.tree.leaves(back), strict=True):
        np.testing.assert_array_equal(old, new)
    assert "form" not in json.loads(
        policy_file.to_json(untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(8,))))
    )


def test_a_damaged_form_is_refused() -> None:
    content = json.loads(policy_file.to_json(made()))
    for wrong in ({"form": "instants"}, {"form": []}, {"form": "x"}, {"history": 2}):
        with pytest.raises(InputError, match="here: "):
            policy_file.from_json(json.dumps({**content, **wrong}), "here")
    del content["gru"]
    with pytest.raises(InputError, match=r"here: memory = 0; .* raptor has memory = 16"):
        policy_file.from_json(json.dumps(content), "here")


@pytest.mark.parametrize("to", [name for name in EXPORTERS.own if name != "raptor"])
def test_other_exporters_refuse_the_form_and_name_the_one_that_takes_it(
    to: str, tmp_path: Path
) -> None:
    if to == "onnx":
        pytest.importorskip("onnx")
    with pytest.raises(InputError, match="--to raptor"):
        export(made(), tmp_path, to, name="policy", seed=0)
    assert not list(tmp_path.iterdir())


def test_other_policies_are_refused_and_told_how_to_train_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="train --form raptor"):
        export_raptor(untrained_policy(jax.random.key(0)), tmp_path)
    one = made()
    heavy = dataclasses.replace(one, observation_mean=one.observation_mean + 3e38)
    huge = one.with_network(((one.weights[0], one.weights[1] * 3e38), one.biases, one.gru))
    for wrong in (heavy, huge):
        with pytest.raises(InputError, match="overflows float32"):
            export_raptor(wrong, tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_command_exports_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    policy_file.write_policy("policy_1.json", made(), {"hover": 0.5})
    cli.commands(["export", "policy_1.json", "--to", "raptor"], standalone_mode=False)
    with h5py.File("raptor_policy/policy.h5") as file:
        record = json.loads(file.attrs["maidenflight"])["record"]
    assert record["settings"]["to"] == "raptor"


def test_training_checks_before_it_begins_that_the_checkpoint_can_hold_what_comes() -> None:
    interface = control.pwm().interface
    spec = PolicySpec(form="raptor")
    check_export("raptor", interface, spec, crazyflie())
    with pytest.raises(InputError, match="train --form raptor"):
        check_export("raptor", interface, dataclasses.replace(spec, form="instants"), crazyflie())
