"""The ONNX model computes what Python computes, in other hands; damaged policies are exported to
nothing."""

import dataclasses
import hashlib
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_c import STRICT

from damaged_json import damaged
from maidenflight import __version__, cli, policy, policy_file, results
from maidenflight.deployment.c import export_c
from maidenflight.errors import InputError
from maidenflight.integrations.exporters.authors_json import interface_of
from maidenflight.integrations.exporters.onnx import IR, OPSET, export_onnx, to_onnx
from maidenflight.policy import untrained_policy
from maidenflight.policy_file import to_json
from maidenflight.simulator.controllers.interface import ControlInterface
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks.look_ahead import LookAhead
from maidenflight.verbs.export import Export
from pages import blocks, run_snippet

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

TURN, LEAN = np.radians(60.0), np.radians(10.0)
COMMANDED = {
    "pwm": lambda a: (a + 1) / 2,
    "attitude_rate": lambda a: np.stack(
        [(a[:, 0] + 1) / 2, TURN * a[:, 1], TURN * a[:, 2], TURN * a[:, 3]], axis=1
    ),
    "attitude": lambda a: np.stack(
        [0.75 + a[:, 0] / 6, LEAN * a[:, 1], LEAN * a[:, 2], LEAN * a[:, 3]], axis=1
    ),
}
"""What clipped actions command."""
RATES = {"pwm": 100, "attitude_rate": 50, "attitude": 25}
ACTIONS = jax.jit(jax.vmap(policy.Policy.__call__, in_axes=(None, 0)))


def made(control="pwm", hidden=(50, 50), history=2):
    """A policy whose actions are of order 1, some beyond."""
    random = np.random.default_rng(0)
    sizes = (20 * history, *hidden, 4)

    def drawn(deviation, *shape):
        return jnp.asarray(deviation * random.normal(size=shape), jnp.float32)

    return policy.Policy(
        weights=tuple(
            drawn(before**-0.5, after, before)
            for before, after in zip(sizes[:-1], sizes[1:], strict=True)
        ),
        biases=tuple(drawn(0.3, size) for size in sizes[1:]),
        observation_mean=drawn(1.0, sizes[0]),
        observation_std=jnp.exp(drawn(1.0, sizes[0])),
        interface=interface_of(control),
        spec=PolicySpec(history=history, hidden=hidden),
    )


def computed(model, observations):
    """Commands and actions as onnxruntime computes them."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(model, options).run(
        ["command", "action"], {"observation": observations}
    )


@pytest.mark.parametrize(
    ("control", "hidden", "history"),
    [
        ("pwm", (50, 50), 2),
        ("attitude_rate", (50, 50), 2),
        ("attitude", (50, 50), 2),
        ("pwm", (), 1),
        ("attitude_rate", (64,), 3),
        ("attitude", (13, 7, 5), 10),
    ],
)
def test_the_model_computes_what_python_computes(control, hidden, history):
    one = made(control, hidden, history)
    spread = np.random.default_rng(1).normal(size=(10_000, 20 * history)).astype(np.float32)
    observations = np.asarray(one.observation_mean) + np.asarray(one.observation_std) * spread
    expected = np.asarray(ACTIONS(one, jnp.asarray(observations)))
    command, action = computed(to_onnx(one), observations)
    assert command.dtype == action.dtype == np.float32
    assert np.all(np.abs(action - expected) <= 1e-5 * np.maximum(1.0, np.abs(expected)))
    np.testing.assert_allclose(
        command, COMMANDED[control](np.clip(expected, -1, 1)), rtol=0, atol=1e-5
    )
    assert (np.abs(expected) > 1).any()


def test_the_model_is_sound_and_says_what_it_is():
    one = made("attitude", (8,), 3)
    one = dataclasses.replace(
        one, interface=dataclasses.replace(one.interface, full_scale_counts=57_344.0)
    )
    model = onnx.load_from_string(to_onnx(one, {"seed": 3, "inputs": ["policy_1.json"]}, 0.58))
    onnx.checker.check_model(model, full_check=True)
    shapes = {
        value.name: [size.dim_param or size.dim_value for size in value.type.tensor_type.shape.dim]
        for value in (*model.graph.input, *model.graph.output)
    }
    assert shapes == {"observation": ["batch", 60], "command": ["batch", 4], "action": ["batch", 4]}
    assert (model.ir_version, [(entry.domain, entry.version) for entry in model.opset_import]) == (
        IR,
        [("", OPSET)],
    )
    told = {entry.key: entry.value for entry in model.metadata_props}
    assert json.loads(told.pop("record")) == {"seed": 3, "inputs": ["policy_1.json"]}
    assert not any("$" in value for value in told.values())
    assert np.float32(told.pop("hover")) == np.float32(0.58)
    assert "57344 of the firmware's 65535 counts" in told["command"]
    assert "-0.174533 to 0.174533 rad" in told.pop("command")
    assert ControlInterface.from_dict(json.loads(told.pop("interface"))) == one.interface
    assert told == {
        "version": __version__,
        "history": "3",
        "instant": json.loads(to_json(one))["instant"],
        "sha256": hashlib.sha256(to_json(one).encode()).hexdigest(),
    }


def test_a_policy_that_looks_ahead_has_a_wider_input_and_says_so():
    one = policy.untrained_policy(
        jax.random.key(0), spec=PolicySpec(look_ahead=LookAhead(3, 0.2), hidden=(8,))
    )
    model = onnx.load_from_string(to_onnx(one))
    told = {entry.key: entry.value for entry in model.metadata_props}
    assert json.loads(told["look_ahead"]) == {"points": 3, "spacing": 0.2}
    assert model.graph.input[0].type.tensor_type.shape.dim[1].dim_value == 49
    observations = np.random.default_rng(1).normal(size=(100, 49)).astype(np.float32)
    command, action = computed(to_onnx(one), observations)
    expected = np.asarray(ACTIONS(one, jnp.asarray(observations)))
    np.testing.assert_allclose(action, expected, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(command, (np.clip(expected, -1, 1) + 1) / 2, atol=1e-5)


def test_a_policy_that_remembers_is_given_its_memory_and_gives_the_next():
    one = policy.untrained_policy(jax.random.key(0), spec=PolicySpec(memory=5, hidden=(8, 6)))
    model = to_onnx(one)
    onnx.checker.check_model(onnx.load_from_string(model), full_check=True)
    told = {entry.key: entry.value for entry in onnx.load_from_string(model).metadata_props}
    assert told["memory"] == "5"
    session = onnxruntime.InferenceSession(model)
    names = ["command", "action", "next_memory"]
    assert [output.name for output in session.get_outputs()] == names
    memory = np.zeros((3, 5), np.float32)
    observations = np.random.default_rng(1).normal(size=(30, 3, 40)).astype(np.float32)
    for observation in observations:
        expected = ACTIONS(one, jnp.asarray(np.concatenate([observation, memory], axis=1)))
        given = {"observation": observation, "memory": memory}
        command, action, memory = session.run(names, given)
        together = np.concatenate([action, memory], axis=1)
        np.testing.assert_allclose(together, expected, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(command, (np.clip(action, -1, 1) + 1) / 2, atol=1e-5)
    assert np.abs(memory).max() > 0.1
    memory[1, 2] = np.nan
    for values in session.run(names, {"observation": observations[0], "memory": memory}):
        assert np.isnan(values).all(axis=1).tolist() == [False, True, False]


def test_the_same_policy_and_record_give_the_same_bytes():
    assert (
        to_onnx(made(), {"seed": 1}) == to_onnx(made(), {"seed": 1}) != to_onnx(made(), {"seed": 2})
    )


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
def test_a_number_that_is_not_finite_makes_its_row_nan_and_no_other(poison):
    one = made(hidden=(8,), history=1)
    observations = np.tile(np.asarray(one.observation_mean), (21, 1))
    sound = computed(to_onnx(one), observations)
    observations[np.arange(20), np.arange(20)] = poison
    for given, expected in zip(computed(to_onnx(one), observations), sound, strict=True):
        assert np.isnan(given[:20]).all()
        assert np.array_equal(given[20], expected[20])


def test_an_action_that_overflows_gives_no_command():
    one = made(hidden=(8,), history=1)
    command, _ = computed(to_onnx(one), np.full((1, 20), 3e38, np.float32))
    assert np.isnan(command).all()


def test_what_makes_no_sense_is_refused(tmp_path):
    one = made()
    for wrong, message in (
        (
            dataclasses.replace(one, biases=(*one.biases[:-1], jnp.array([0, 0, jnp.nan, 0]))),
            "not a finite number",
        ),
        (
            dataclasses.replace(one, weights=(*one.weights[:-1], jnp.full((4, 50), 3e38))),
            "overflows float32",
        ),
        (jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), one), "expected"),
    ):
        with pytest.raises(InputError, match=message):
            export_onnx(wrong, tmp_path)
    assert not list(tmp_path.iterdir())


OURS = json.loads(
    to_json(untrained_policy(jax.random.key(0), spec=PolicySpec(history=1, hidden=(3,))))
)
THEIRS = {
    "check_sum": "0.0",
    "scaling_parameters": [[0.0] * 40, [1.0] * 40],
    "activation": "relu",
    "0": {"type": "standard", "weights": [[0.0] * 40] * 4, "biases": [0.0] * 4},
}


@pytest.mark.parametrize("to", ["c", "onnx", "authors"])
@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\xff\xfe\x00",
        b"[" * 100_000,
        b"1" * 10_000,
        b"null",
        damaged(OURS, "format", to="maidenflight policy 9").encode(),
        damaged(OURS, "interface", "rate", to=1e400).encode(),
        damaged(OURS, "history", to=10**9).encode(),
        damaged(OURS, "layers", 0, "weights", 0, 0, to=1e39).encode(),
        damaged(OURS, "layers", 1, "biases", to=[[]]).encode(),
        damaged(OURS, "layers", to={}).encode(),
        damaged(OURS, "observation_std", 3, to=0).encode(),
        damaged(THEIRS, "0", "weights", 0, 0, to=1.0).encode(),
        damaged(THEIRS, "0", "weights", 0, to="weights").encode(),
        damaged(THEIRS, "scaling_parameters", 1, 0, to=-1.0).encode(),
        *(json.dumps(OURS).encode()[:length] for length in range(1, len(json.dumps(OURS)), 700)),
        *(
            json.dumps(THEIRS).encode()[:length]
            for length in range(1, len(json.dumps(THEIRS)), 400)
        ),
    ],
)  # fmt: skip
def test_a_damaged_or_truncated_policy_gives_one_error_and_no_file(tmp_path, to, text):
    path = tmp_path / "pwm_1.json"
    path.write_bytes(text)
    with pytest.raises(InputError, match=r"pwm_1\.json: ") as caught:
        Export(policy=path, to=to).run(tmp_path / "to")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "to").exists()


def said(monkeypatch, capsys, *arguments):
    """Exit code of a command, and what it wrote."""
    monkeypatch.setattr(sys, "argv", ["maidenflight", *map(str, arguments)])
    try:
        cli.main()
        code = 0
    except SystemExit as leaving:
        code = leaving.code
    return code, capsys.readouterr()


def test_the_command_exports_both_kinds_of_policies_to_everything(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    policy_file.write_policy(
        "mine.json", untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(8,)))
    )
    Path("theirs.json").write_text(json.dumps(THEIRS))
    for arguments, files in (
        (["mine.json"], ["firmware/policy.h", "firmware/policy.c"]),
        (["mine.json", "--to", "onnx"], ["onnx_policy/policy.onnx"]),
        (["mine.json", "--to", "authors"], ["authors_policy/pwm_mine.json"]),
        (["theirs.json", "--control", "attitude", "-o", "a"], ["a/policy.h", "a/policy.c"]),
        (["theirs.json", "--control", "attitude", "--to", "onnx", "-o", "b"], ["b/policy.onnx"]),
        (
            ["theirs.json", "--control", "attitude", "--to", "authors", "-o", "c"],
            ["c/attitude_theirs.json"],
        ),
        (["authors_policy/pwm_mine.json", "--to", "onnx", "-o", "d"], ["d/policy.onnx"]),
    ):
        code, output = said(monkeypatch, capsys, "export", *arguments, "--json")
        assert (code, json.loads(output.out)) == (0, {"files": files})
        assert all(Path(file).exists() for file in files)
    assert '#define MF_CONTROL "attitude"' in Path("a/policy.h").read_text()
    for arguments, message in (
        (["theirs.json", "-o", "e"], "do not say what they command"),
        (["mine.json", "--to", "onnx"], "onnx_policy: already there"),
        (["mine.json", "--to", "keras"], "keras"),
    ):
        code, output = said(monkeypatch, capsys, "export", *arguments)
        assert (code, output.out) == (2, "")
        assert message in output.err


def test_c_is_what_is_exported_unless_told_and_as_before(tmp_path):
    path = policy_file.write_policy(
        tmp_path / "policy_1.json",
        untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(8,))),
    )
    given = Export(policy=path, seed=7).run(tmp_path / "given").value
    expected = export_c(
        policy_file.read_policy(path).policy,
        tmp_path / "expected",
        seed=7,
        record=results.record(
            seed=7,
            inputs=[path],
            settings={"to": "c", "control": policy_file.read_policy(path).interface.name},
        ),
    )
    assert [file.read_bytes() for file in given] == [file.read_bytes() for file in expected]


def test_the_commands_and_the_code_of_the_page_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    policy_file.write_policy(
        "policies/policy_1.json", untrained_policy(jax.random.key(0)), {"hover": 0.58}
    )
    Path("attitude_rate_066.json").write_text(json.dumps(THEIRS))
    commands = [
        line
        for line in blocks("docs/export.md", "sh")[0].splitlines()
        if line.startswith("maidenflight ")
    ]
    assert len(commands) >= 4
    for line in commands:
        code, output = said(monkeypatch, capsys, *shlex.split(line, comments=True)[1:])
        assert (code, output.err) == (0, "")
    # That with RAPTOR's reader runs in test_raptor_export.py.
    for snippet in [
        one for one in blocks("docs/export.md", "python") if "foundation_policy" not in one
    ]:
        run_snippet(snippet, "docs/export.md")
    assert re.match(r"\[0\.", capsys.readouterr().out)
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler:
        (snippet,) = blocks("docs/export.md", "c")
        Path("firmware/main.c").write_text(snippet)
        (line,) = re.findall(r"/\* cc (.*) \*/", snippet)
        subprocess.run([compiler, *STRICT, *line.split()], cwd="firmware", check=True)
        spoken = subprocess.run(["firmware/fly"], capture_output=True, text=True, check=True).stdout
        assert len(re.findall(r"0\.\d+", spoken)) == 4
