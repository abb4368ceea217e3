"""XLA's flags, that programs compiled by them compute what others do, and the cores they run on."""

import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import maidenflight as mf
from maidenflight import compiler
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.stepping import randomized_reset

PROGRAM = """
import sys
import jax, jax.numpy as jnp, numpy as np
import maidenflight as mf
from maidenflight.policy import untrained_policy
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import control
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.stepping import rollout

drone = mf.parameters.read_drone("crazyflie")
controller = control.pwm()
fitting = control.in_fitting_steps(drone, controller)
env = Environment.matching(fitting, mf.simulator.circle(), controller)
policy = untrained_policy(jax.random.key(1), controller.interface, PolicySpec(hidden=(8, 8)))


def cost(fitting):
    def fly(key):
        begun = environment.reset(env, fitting, key)
        return rollout(env, policy, begun, fitting, key, 8)

    states = jax.vmap(fly)(jax.random.split(jax.random.key(0), 32))[1][0].state
    return jnp.mean(states.position**2) + jnp.mean(states.body_rates**2), states


(value, states), slope = jax.jit(jax.value_and_grad(cost, has_aux=True))(
    jax.tree.map(jnp.asarray, fitting)
)
slopes = {f"slope {name}": getattr(slope, name) for name in ("latency", "inertia")}
np.savez(sys.argv[1], **states._asdict(), **slopes)
"""


USUAL = {"JAX_COMPILATION_CACHE_DIR": "", "JAX_DISABLE_MOST_OPTIMIZATIONS": "0"}


def computed(path: Path, flags: str) -> Any:
    made = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(path)],
        env={**os.environ, "XLA_FLAGS": flags, **USUAL},
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.returncode == 0, made.stderr
    return np.load(path)


@pytest.mark.night
def test_flags_change_rounding_alone(tmp_path: Path) -> None:
    ours = computed(tmp_path / "ours.npz", compiler.FUSED)
    others = computed(tmp_path / "others.npz", compiler.QUICK)
    assert set(ours) == set(others)
    for name in ours:
        assert np.all(np.isfinite(ours[name])), name
        scale = np.max(np.abs(others[name])) + 1e-6
        np.testing.assert_allclose(ours[name], others[name], atol=2e-3 * scale, err_msg=name)


def test_the_latest_flags_count_but_ones_own_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XLA_FLAGS")
    for flags in (compiler.QUICK, compiler.FUSED, compiler.QUICK):
        compiler.set_flags(flags)
        assert os.environ["XLA_FLAGS"] == flags
    for own in ("--xla_force_host_platform_device_count=2", ""):
        monkeypatch.setenv("XLA_FLAGS", own)
        compiler.set_flags(compiler.FUSED)
        assert os.environ["XLA_FLAGS"] == own


@pytest.mark.slow
def test_jax_is_prepared_in_a_process_of_its_own(tmp_path: Path) -> None:
    asked = (
        "import os, maidenflight as mf; mf.prepare_jax(3, fused=True); import jax; "
        "print(jax.device_count(), os.environ['XLA_FLAGS'])"
    )
    places = {"XDG_CACHE_HOME": str(tmp_path), "XLA_FLAGS": compiler.QUICK}
    said = subprocess.run(
        [sys.executable, "-c", asked],
        env={**os.environ, **places},
        capture_output=True,
        text=True,
        check=True,
    )
    assert said.stdout.split() == ["3", compiler.FUSED]


def test_where_jax_runs_already_its_devices_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    import jax

    monkeypatch.setenv("XLA_FLAGS", "")
    before = jax.device_count()
    mf.prepare_jax(before + 1)
    assert jax.device_count() == before


@pytest.mark.slow
def test_programs_that_run_once_are_compiled_for_the_same_result() -> None:
    box, keys = mf.simulator.relative_box(mf.crazyflie()), jax.random.split(jax.random.key(3), 4)
    begun = jax.vmap(partial(randomized_reset, Environment(), box))
    plain, once = jax.jit(begun)(keys), jax.jit(begun, compiler_options=compiler.once())(keys)
    for one, other in zip(jax.tree.leaves(plain), jax.tree.leaves(once), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("version", "has"), [("0.10.2", True), ("0.11.2", False), ("0.12.0.1", False)]
)
def test_options_are_those_that_xla_knows(
    monkeypatch: pytest.MonkeyPatch, version: str, has: bool
) -> None:
    monkeypatch.setattr("jaxlib.version.__version__", version)
    known = compiler.has_older_emitter.__wrapped__
    monkeypatch.setattr(compiler, "has_older_emitter", known)
    assert ("xla_cpu_use_fusion_emitters" in compiler.once()) is has


def test_xla_takes_the_options_here() -> None:
    assert jax.jit(lambda value: value + 1.0, compiler_options=compiler.once())(1.0) == 2.0


def test_the_cores_are_those_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5, 7}, raising=False)
    assert compiler.count_cores() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert compiler.count_cores() == 1


@pytest.mark.slow
def test_each_core_becomes_a_device_and_a_jax_that_runs_is_left_alone() -> None:
    program = (
        "from maidenflight import compiler\nimport jax\ncompiler.count_cores = lambda: "
        "3\n{}compiler.as_devices()\nprint(jax.device_count())"
    )
    found = [
        subprocess.run(
            [sys.executable, "-c", program.format(first)],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
        for first in ("", "jax.device_count()\n")
    ]
    assert found[0] == "3"
    assert found[1] == "1"
