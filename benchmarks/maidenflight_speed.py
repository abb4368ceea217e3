"""maidenflight's side of `simulator.py`: measures what it is asked for.

`python maidenflight_speed.py` answers one JSON object a line, `{"series", "batch", "layout",
"seconds"}`, with a rate. With the name of a single measurement (`first`, `memory`, `single`) it
makes that one and leaves.

XLA runs a program of small arrays on one core. So drones are laid on as many CPU devices as there
are cores, and each device takes them in chunks that fit its cache. Everything is open to the
compiler's eyes only as it is in training: parameters are arguments.
"""

import os
import resource
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
from serving import Prepared, rate, serve

CORES = len(os.sched_getaffinity(0))
if __name__ == "__main__" and len(sys.argv) == 1:
    jax.config.update("jax_num_cpu_devices", CORES)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from jax.sharding import Mesh, NamedSharding, PartitionSpec  # noqa: E402

from maidenflight.parameters import Parameters, crazyflie, replace  # noqa: E402
from maidenflight.simulator import environment, stepping  # noqa: E402
from maidenflight.simulator.controllers import control  # noqa: E402
from maidenflight.simulator.environment import Environment, EnvState  # noqa: E402
from maidenflight.simulator.physics import dynamics, latency, motion, vectors  # noqa: E402
from maidenflight.simulator.physics.actuators import rotor_speed_command  # noqa: E402
from maidenflight.simulator.physics.sensors import Measurement  # noqa: E402
from maidenflight.simulator.randomization import relative_box  # noqa: E402
from maidenflight.simulator.stepping import EnvInstance, randomized_reset  # noqa: E402

ARRAYS = "one core, arrays"
"""The state as arrays, of a single drone without an axis for drones: for few drones, whose time is
that of starting loops."""
LAYOUTS = {
    ARRAYS: (1, 0),
    "one core": (1, 0),
    "all cores": (CORES, 0),
    "all cores, by 256": (CORES, 256),
    "all cores, by 1,024": (CORES, 1024),
}
"""CPU devices, and drones that a device simulates at once; 0: all of its share."""
FRESH = 2
"""Drones prepared for those whose episode ends, for each that flies, new for each call: one reset
every `HORIZON` / 2 steps."""
COMMANDS = 10
"""Commands of the rate PID an action of 50 Hz."""
HORIZON = 64
"""Steps of a call of the training series, as many as training differentiates through."""

Run = Callable[[Any, Any], Any]
"""(what all drones share, what each has, stacked) to what each has afterwards."""


driven = partial(motion.drive_entries, dynamics.euler)
"""The state after a command's period."""


def rollout_with_auto_reset(
    world: Environment,
    policy: Callable[[jax.Array], jax.Array],
    drone: EnvInstance,
    fresh: EnvInstance,
    key: jax.Array,
    steps: int,
) -> tuple[EnvInstance, tuple[EnvState, stepping.StepResult]]:
    """Flies a policy for a number of control periods; after an episode the next drone flies.

    Args:
        world: what is simulated.
        policy: observation to action.
        drone: where to begin.
        fresh: F drones at the start of an episode, stacked along a first axis; a reset in period n
            takes number n modulo F.
        key: random key.
        steps: control periods; static.

    Returns:
        The last instance, and the state before and the result of each period, stacked along a first
        axis of `steps`.
    """
    count = fresh.env_state.time.shape[0]

    def one(
        drone: EnvInstance, now: tuple[jax.Array, jax.Array]
    ) -> tuple[EnvInstance, tuple[EnvState, stepping.StepResult]]:
        number, key = now
        env_state, step_result = stepping.step(
            world,
            drone.env_state,
            policy(environment.observation(world, drone.env_state)),
            drone.parameters,
            key,
        )
        over = step_result.terminated | step_result.truncated
        after, new = (
            EnvInstance(env_state, drone.parameters),
            jax.tree.map(lambda leaf: leaf[number % count], fresh),
        )
        return jax.tree.map(lambda old, new: jnp.where(over, new, old), after, new), (
            drone.env_state,
            step_result,
        )

    return jax.lax.scan(one, drone, (jnp.arange(steps), jax.random.split(key, steps)))


def motor_level(
    shared: Parameters, own: Any, commands: int, steps: int = 2, drive: Any = driven
) -> Any:
    """One drone whose motors are commanded at 100 Hz: motor lag, delay line, rigid body.

    5 ms a physics step; the state as `vectors.Entries`, which is faster for many drones, or with
    another `drive` as arrays.
    """

    def hold(carry: Any, number: jax.Array) -> tuple[Any, None]:
        state, delay_line = carry
        line = latency.put(delay_line, own["command"], number)
        return (drive(state, line, steps, shared), line.commands), None

    (state, delay_line), _ = jax.lax.scan(hold, own["flown"], jnp.arange(commands))
    return own | {"flown": (state, latency.in_front(delay_line, commands))}


def rate_pid(shared: Parameters, own: Any, commands: int, drive: Any = driven) -> Any:
    """One drone under body-rate control.

    The firmware's PID at 500 Hz, motor lag, delay line and rigid body; 2 ms per physics step. All
    vectors are `vectors.Entries`, or with another `drive` arrays.
    """
    controller = control.attitude_rate()

    def act(carry: Any, _: None) -> tuple[Any, None]:
        def hold(carry: Any, number: jax.Array) -> tuple[Any, None]:
            state, delay_line, memory = carry
            exact = Measurement(*state[:4])
            memory, command = controller.command(memory, own["action"], exact, jnp.zeros(3))
            line = latency.put(delay_line, rotor_speed_command(command), number)
            return (drive(state, line, 1, shared), line.commands, memory), None

        (state, delay_line, memory), _ = jax.lax.scan(hold, carry, jnp.arange(COMMANDS))
        return (state, latency.in_front(delay_line, COMMANDS), memory), None

    carry, _ = jax.lax.scan(act, own["flown"], None, length=commands // COMMANDS)
    return own | {"flown": carry}


def as_arrays(own: Any) -> Any:
    """The same with vectors as arrays, their entries on the last axis."""
    return jax.tree.map(
        lambda leaf: jnp.stack(list(leaf), -1) if isinstance(leaf, vectors.Entries) else leaf,
        own,
        is_leaf=lambda leaf: isinstance(leaf, vectors.Entries),
    )


def training(shared: Any, own: Any, steps: int) -> Any:
    """One drone in training: policy, noise, randomization, reward, termination, reset.

    100 Hz PWM.
    """
    world, weights = Environment(), shared["weights"]

    def policy(observation: jax.Array) -> jax.Array:
        return jnp.tanh(weights @ observation)

    key, fresh_key, fly_key = jax.random.split(own["key"], 3)
    fresh = (
        own["fresh"]
        if "fresh" in own
        else jax.vmap(partial(randomized_reset, world, shared["box"]))(
            jax.random.split(fresh_key, FRESH)
        )
    )
    drone, (before, step_result) = rollout_with_auto_reset(
        world, policy, own["drone"], fresh, fly_key, steps
    )
    answer = (
        jax.vmap(partial(environment.observation, world))(before),
        step_result.reward,
        step_result.terminated,
        step_result.truncated,
    )
    return {"key": key, "drone": drone, "told": answer}


@jax.jit
def launch(box: Any, keys: jax.Array) -> Any:
    """One drone for each key."""
    return jax.vmap(partial(randomized_reset, Environment(), box))(keys)


def drones(series: str, batch: int) -> tuple[Any, Any]:
    """What all drones share and what each has, at the start."""
    keys = jax.random.split(jax.random.key(0), batch)
    if series == "training":
        box = relative_box(jax.tree.map(jnp.asarray, crazyflie()))
        weights = 0.1 * jax.random.normal(jax.random.key(1), (4, 40))
        return {"box": box, "weights": weights}, {"key": keys, "drone": launch(box, keys)}
    step, rate = (0.005, 100) if series == "motor" else (0.002, 500)
    shared = jax.tree.map(jnp.asarray, replace(crazyflie(), time_step=step))

    def one(key: jax.Array) -> Any:
        state = dynamics.at_hover(jax.random.normal(key, (3,)), shared)
        state = state._replace(body_rates=0.1 * jax.random.normal(key, (3,)))
        slots = latency.slots(1 / rate)
        delay_line = vectors.Entries(jnp.full(slots, speed) for speed in state.rotor_speed)
        state = vectors.entries(state)
        if series == "motor":
            return {"flown": (state, delay_line), "command": state.rotor_speed}
        memory = vectors.entries(jax.tree.map(jnp.asarray, control.attitude_rate().init()))
        return {"flown": (state, delay_line, memory), "action": jnp.array([0.1, 0.0, 0.0, 0.0])}

    return shared, jax.jit(jax.vmap(one))(keys)


SERIES: dict[str, tuple[Callable[..., Any], int]] = {
    "motor": (motor_level, 2),
    "rate": (rate_pid, 1),
    "training": (training, 1),
}
"""One drone's function, and the steps that are counted a turn of its loop: physics steps, in
training steps of the environment."""
OF_ARRAYS: dict[str, Callable[..., Any]] = {
    name: partial(one, drive=partial(motion.drive, dynamics.euler))
    for name, one in (("motor", motor_level), ("rate", rate_pid))
}
"""The same of states of arrays."""


def in_chunks(run: Run, size: int) -> Run:
    """The same for many drones, `size` of them at a time."""

    def many(shared: Any, own: Any) -> Any:
        count = jax.tree.leaves(own)[0].shape[0] // size
        cut = jax.tree.map(lambda leaf: leaf.reshape(count, size, *leaf.shape[1:]), own)
        done = jax.lax.map(partial(run, shared), cut)
        return jax.tree.map(lambda leaf: leaf.reshape(count * size, *leaf.shape[2:]), done)

    return many


def prepare(series: str, batch: int, layout: str) -> Prepared | None:
    """A call that simulates, and the steps that it counts for.

    Nothing where the layout does not fit the batch.
    """
    devices, size = LAYOUTS[layout]
    if batch % devices or (size and batch // devices <= size):
        return None
    one, counted = SERIES[series]
    turns = (
        max(min(HORIZON, 2**20 // batch), 16)
        if series == "training"
        else max(min(2**20 // batch, 1024), 64)
    )
    shared, own = drones(series, batch)
    if layout == ARRAYS:
        if series not in OF_ARRAYS:
            return None
        one, own = OF_ARRAYS[series], as_arrays(own)
    single: Run = partial(one, **{"steps" if series == "training" else "commands": turns})
    run: Run = jax.vmap(single, in_axes=(None, 0))
    if layout == ARRAYS and batch == 1:
        run, own = single, jax.tree.map(lambda leaf: leaf[0], own)
    run = in_chunks(run, size) if size else run
    if devices > 1:
        mesh, split, whole = (
            Mesh(np.array(jax.devices()[:devices]), ("drones",)),
            PartitionSpec("drones"),
            PartitionSpec(),
        )
        own, shared = (
            jax.device_put(own, NamedSharding(mesh, split)),
            jax.device_put(shared, NamedSharding(mesh, whole)),
        )
        run = jax.shard_map(
            run, mesh=mesh, in_specs=(whole, split), out_specs=split, check_vma=False
        )
    compiled = jax.jit(run)

    def call() -> None:
        nonlocal own
        after = jax.block_until_ready(compiled(shared, own))
        own = {name: after[name] for name in own}

    return call, batch * turns * counted


def first() -> None:
    """The first step of a fresh process."""
    world, parameters, key = Environment(), crazyflie(), jax.random.key(0)
    env_state = jax.jit(environment.reset, static_argnums=0)(world, parameters, key)
    _, step_result = jax.jit(stepping.step, static_argnums=0)(
        world, env_state, np.zeros(4, np.float32), parameters, key
    )
    print(float(step_result.reward))


def memory() -> None:
    """Peak memory [MB] of a process that flies 1,000 drones in training and keeps rewards and ends.

    Set up without eager JAX.
    """
    generator, world, box = np.random.default_rng(0), Environment(), relative_box(crazyflie())
    bits, weights = (
        generator.integers(0, 2**32, (1000, 2), dtype=np.uint32),
        generator.normal(0.0, 0.1, (4, 40)).astype(np.float32),
    )

    def begin(bits: jax.Array) -> Any:
        return randomized_reset(world, box, jax.random.wrap_key_data(bits))

    def fly(weights: jax.Array, drone: Any, fresh: Any, bits: jax.Array) -> Any:
        key = jax.random.wrap_key_data(bits)
        drone, (_, step_result) = rollout_with_auto_reset(
            world, lambda observation: jnp.tanh(weights @ observation), drone, fresh, key, HORIZON
        )
        return drone, step_result.reward, step_result.terminated, step_result.truncated

    first = jax.jit(jax.vmap(begin))(bits)
    fresh = jax.tree.map(lambda leaf: np.asarray(leaf)[:, None], first)
    run = jax.jit(jax.vmap(fly, in_axes=(None, 0, 0, 0)))
    drone = run(weights, first, fresh, bits)[0]
    jax.block_until_ready(run(weights, drone, fresh, bits + np.uint32(1)))
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6)


def single() -> None:
    """Steps a second of one Gymnasium environment, resets included."""
    import gymnasium  # pyright: ignore[reportMissingImports]

    import maidenflight.integrations.gym  # noqa: F401  registers

    world = gymnasium.make("maidenflight/Circle-v0")
    world.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-0.2, 0.5, (1000, 4)).astype(np.float32)

    def fly() -> None:
        for action in actions:
            _, _, terminated, truncated, _ = world.step(action)
            if terminated or truncated:
                world.reset()

    fly()
    print(rate(fly, len(actions), seconds=2.0))


if __name__ == "__main__":
    {"first": first, "memory": memory, "single": single}[sys.argv[1]]() if len(
        sys.argv
    ) > 1 else serve(prepare)
