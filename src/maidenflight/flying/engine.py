"""The flight engine: pilots fly scenarios in realities, up to where a guard ends their flights.

`fly_all` flies many flights, of virtual drones all at once. `simulate`, which that is made of, is a
pure function of one drone. `fly` flies a stateful reality, one command at a time, from the same
starts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.errors import InputError
from maidenflight.flying.firmware_pilot import FirmwarePilot
from maidenflight.flying.pilots import Act, ForeignPilot, PolicyPilot
from maidenflight.flying.rows import Rows, SimulatedFlight
from maidenflight.flying.scenario import Change, Scenario, near_reference
from maidenflight.parameters import Parameters
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics, rotations, sensors
from maidenflight.simulator.physics.battery import Supply
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.realities.reality import MOTORS, AnyReality, Reality, Truth
from maidenflight.simulator.realities.stepped import Stepped
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from maidenflight.simulator.tasks import failures
from maidenflight.simulator.tasks.failures import Guard
from maidenflight.simulator.tasks.tasks import Task

PilotOfMany = PolicyPilot | FirmwarePilot
Pilot = PilotOfMany | ForeignPilot


def simulate(
    env: Environment,
    act: Act,
    parameters: Parameters,
    key: Array,
    steps: int,
    start: Float[Array, ""] | float = 0.0,
    during: Change | None = None,
) -> Rows:
    """Flies from hover near the reference's start and logs every control period.

    A failed flight goes on; the caller decides where it ended.

    Args:
        env: what is simulated.
        act: (observation, number of the control period) to action.
        parameters: the drone.
        key: random key.
        steps: control periods, static.
        start: the reference's clock at the start [s].
        during: what changes of the drone in the course of the flight; nothing by default.
    """
    offset, begin_key, key = near_reference(key)
    state = dynamics.at_hover(env.task.reference(jnp.asarray(start)) + offset, parameters)
    first = environment.begin(env, state, jnp.asarray(start), parameters, begin_key)

    def advance(
        env_state: environment.EnvState, now: tuple[Array, Array]
    ) -> tuple[environment.EnvState, Rows]:
        number, key = now
        drone = parameters if during is None else during(parameters, env_state.elapsed)
        after, step_result = stepping.step(
            env, env_state, act(environment.observation(env, env_state), number), drone, key
        )
        measurement = env_state.measurement
        motors = after.actuators if env.commands_per_action == 1 else env_state.actuators
        return after, Rows(
            position=measurement.position,
            velocity=measurement.velocity,
            attitude=rotations.to_attitude(measurement.quaternion),
            body_rates=measurement.body_rates,
            ratio=motors.ratio,
            battery=motors.voltage,
            setpoint=env.task.reference(env_state.time),
            true_position=after.state.position,
            true_setpoint=step_result.setpoint,
            true_attitude=rotations.to_attitude(after.state.quaternion),
            true_body_rates=after.state.body_rates,
            true_velocity=after.state.velocity,
            rotor_speed=env_state.state.rotor_speed,
        )

    return jax.lax.scan(advance, first, (jnp.arange(steps), jax.random.split(key, steps)))[1]


def fly_all(
    reality: AnyReality,
    pilots: Pilot | Sequence[Pilot],
    scenario: Scenario,
    keys: Array,
    guard: Guard | None = None,
) -> list[SimulatedFlight]:
    """Flies a flight for each key.

    Virtual drones fly all at once where pilots can; all else flies one flight after another.

    Args:
        reality: where.
        pilots: one for all flights, or one for each: of one kind those that fly many drones.
        scenario: the task, its duration and the initial states.
        keys: random keys.
        guard: what ends a flight before its time.

    Raises:
        InputError: the reality takes other commands than the pilots', or changes in the course of a
            flight where that is not simulated.
    """
    each = list(pilots) if isinstance(pilots, Sequence) else [pilots] * len(keys)
    if not isinstance(reality, VirtualDrone):
        if scenario.during is not None or scenario.drones is not None:
            raise InputError(
                f"{reality.name}: other drones, and what changes of one in flight, fly as virtual "
                "drones only. Name one of these."
            )
        return [
            fly(reality, pilot, scenario, key, guard) for pilot, key in zip(each, keys, strict=True)
        ]
    drones = scenario.drones or [reality.parameters] * len(keys)
    batch = [index for index, pilot in enumerate(each) if isinstance(pilot, PilotOfMany)]
    flights: dict[int, SimulatedFlight] = {}
    for index in set(range(len(each))).difference(batch):
        if scenario.during is not None:
            raise InputError(
                f"{reality.name}: what changes in the course of a flight is flown by our own "
                "policies only. Leave it out of --along."
            )
        stepped = Stepped(replace(reality, parameters=drones[index]))
        flights[index] = fly(stepped, each[index], scenario, keys[index], guard)
    if batch:
        pilot = [each[index] for index in batch] if isinstance(pilots, Sequence) else pilots
        if len(batch) < len(each):
            drones = [drones[index] for index in batch]
            keys = jnp.stack([keys[index] for index in batch])
        for some in _kinds(pilot, len(batch)):
            flights |= zip(
                [batch[index] for index in some],
                _fly_together(
                    reality,
                    [pilot[index] for index in some] if isinstance(pilot, list) else pilot,
                    [drones[index] for index in some],
                    scenario,
                    keys[np.array(some)],
                    guard,
                ),
                strict=True,
            )
    return [flights[index] for index in range(len(each))]


def _kinds(pilots: Any, count: int) -> list[list[int]]:
    """Places of pilots that one program flies: alike in all but their numbers."""
    if not isinstance(pilots, list):
        return [list(range(count))]
    kinds: dict[Any, list[int]] = {}
    for index, pilot in enumerate(pilots):
        shapes = tuple(map(np.shape, jax.tree.leaves(pilot)))
        kinds.setdefault((jax.tree.structure(pilot), shapes), []).append(index)
    return list(kinds.values())


def _fly_together(
    reality: VirtualDrone,
    pilots: Any,
    drones: Sequence[Parameters],
    scenario: Scenario,
    keys: Array,
    guard: Guard | None,
) -> Iterator[SimulatedFlight]:
    """Flights of virtual drones, all at once."""
    several = isinstance(pilots, Sequence)
    first = pilots[0] if several else pilots
    env = first.environment(reality, scenario)
    # Those of policies are stacked, also where they are one drone: as many drones fly the same.
    has_one_drone = isinstance(first, FirmwarePilot) and scenario.drones is None
    rows = _simulate(
        env,
        round(scenario.duration * env.controller.interface.rate),
        several,
        _stack(pilots) if several else pilots,
        reality.parameters if has_one_drone else _stack(drones),
        keys,
        reality.later if scenario.changing else scenario.during,
    )
    rows = jax.tree.map(np.asarray, rows)
    for index, drone in enumerate(drones):
        yield _cut_at_end(
            jax.tree.map(lambda values, index=index: values[index], rows),
            guard,
            rate=env.controller.interface.rate,
            zero_order_hold=env.commands_per_action == 1,
            supply=env.supply,
            reality=reality.name,
            drone=drone,
            estimated=sensors.drifts(drone),
        )


def _stack(trees: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: np.stack(leaves), *trees)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _simulate(
    env: Environment,
    steps: int,
    several: bool,
    pilots: PilotOfMany,
    drones: Parameters,
    keys: Array,
    during: Change | None,
) -> Rows:
    def fly_pilot(pilot: PilotOfMany, drone: Parameters, key: Array) -> Rows:
        own, act, key = pilot.begin(env, key, steps)
        return simulate(own, act, drone, key, steps, during=during)

    axes = 0 if several else None, 0 if drones.mass.ndim else None, 0
    return jax.vmap(fly_pilot, axes)(pilots, drones, keys)


def _cut_at_end(rows: Rows, guard: Guard | None, **logged: Any) -> SimulatedFlight:
    if guard is None:
        return SimulatedFlight(rows, **logged)
    end = rows.end(guard, logged.get("estimated", False))
    rows = jax.tree.map(lambda values: values[: end.steps], rows)
    return SimulatedFlight(rows, reason=int(end.reason), **logged)


def fly(
    reality: Reality,
    pilot: Pilot,
    scenario: Scenario,
    key: Array,
    guard: Guard | None = None,
) -> SimulatedFlight:
    """Flies a reality one command at a time, and logs as `simulate` does with the same key.

    Args:
        reality: the drone or simulator; it is reset first.
        pilot: what flies it.
        scenario: the task, its duration and the initial states.
        key: random key.
        guard: what ends the flight before its time.

    Raises:
        InputError: the reality takes other commands than the pilot's, its rate is no multiple of
            theirs, or what it returns has wrong shapes.
    """
    commander, key = pilot.begin_stepped(reality, scenario, key)
    if reality.rate % commander.command_rate:
        raise InputError(
            f"{reality.name}: rate = {reality.rate} Hz, expected a multiple of the "
            f"{commander.command_rate} Hz at which it is commanded."
        )
    zero_order_hold = reality.takes == MOTORS and commander.command_rate == commander.rate
    steps = round(scenario.duration * commander.rate)
    setpoints, offset, seed = map(np.asarray, _plan(commander.task, commander.rate, steps, key))
    reality.reset((setpoints[0] + offset).astype(np.float64), int(seed))
    drone = getattr(reality, "parameters", None)
    estimated = drone is not None and sensors.drifts(drone)
    rows: list[tuple[Measurement, Float[np.ndarray, 4], Truth]] = []
    for setpoint, following in zip(setpoints[:-1], setpoints[1:], strict=True):
        before, measured = _truth(reality), _measurement(reality)
        for number in range(commander.command_rate // commander.rate):
            measurement = _measurement(reality) if number else measured
            command = np.asarray(commander.fly(measurement, setpoint), np.float64)
            if reality.takes == MOTORS:
                command = np.minimum(command, 1.0)
            for _ in range(reality.rate // commander.command_rate):
                reality.step(command)
        after = _truth(reality)
        rows.append((measured, (after if zero_order_hold else before).command, after))
        judged = (measured, setpoint) if estimated else (after, following)
        if guard is not None and _ends(guard, *judged):
            break
    return _cut_at_end(
        _stacked(rows, setpoints),
        guard,
        rate=commander.rate,
        zero_order_hold=zero_order_hold,
        supply=Supply(full_scale_counts=pilot.full_scale_counts),
        reality=reality.name,
        estimated=estimated,
    )


@partial(jax.jit, static_argnums=(0, 1, 2))
def _plan(
    task: Task, rate: int, steps: int, key: Array
) -> tuple[Float[Array, "steps+1 3"], Float[Array, "3"], Array]:
    """Set-points at the ends of the periods, offset of the start from the first, and a seed."""
    times = jnp.arange(steps + 1, dtype=jnp.float32) / rate
    offset, begin_key, _ = near_reference(key)
    return jax.vmap(task.reference)(times), offset, jax.random.bits(begin_key, dtype=jnp.uint32)


def _ends(guard: Guard, measured: Truth | Measurement, setpoint: Float[np.ndarray, "3"]) -> bool:
    attitude = np.asarray(_attitude(measured.quaternion))
    now = failures.excursion(np.asarray(measured.position), attitude, measured.body_rates, setpoint)
    return any(guard.trips(now).values())


_attitude = jax.jit(rotations.to_attitude)


def _stacked(
    rows: Sequence[tuple[Measurement, Float[np.ndarray, "4"], Truth]],
    setpoints: Float[np.ndarray, "M 3"],
) -> Rows:
    measured, commands, true = (
        jax.tree.map(lambda *parts: np.stack(parts), *column) for column in zip(*rows, strict=True)
    )
    fields: dict[str, Any] = {
        "position": measured.position,
        "velocity": measured.velocity,
        "attitude": np.asarray(_attitudes(measured.quaternion)),
        "body_rates": measured.body_rates,
        "ratio": commands,
        "battery": np.full(len(rows), np.nan, np.float32),
        "setpoint": setpoints[: len(rows)],
        "true_position": true.position,
        "true_setpoint": setpoints[1 : len(rows) + 1],
        "true_attitude": np.asarray(_attitudes(true.quaternion)),
        "true_body_rates": true.body_rates,
        "true_velocity": np.full((len(rows), 3), np.nan, np.float32),
        "rotor_speed": np.full((len(rows), 4), np.nan, np.float32),
    }
    return Rows(**fields)


_attitudes = jax.jit(jax.vmap(rotations.to_attitude))


def _measurement(reality: Reality) -> Measurement:
    parts: Any = _arrays(reality, "observe", reality.observe(), (3, 3, 4, 3))
    return Measurement(*parts)


def _truth(reality: Reality) -> Truth:
    return Truth(*_arrays(reality, "truth", reality.truth(), (3, 4, 3, 4)))


def _arrays(reality: Reality, name: str, parts: Any, sizes: Sequence[int]) -> list[np.ndarray]:
    """What a reality returned, as float32 vectors of these sizes."""
    try:
        arrays = [np.asarray(part, np.float32) for part in parts]
    except (TypeError, ValueError) as error:
        raise InputError(f"{reality.name}: {name}() gives {parts!r:.80}; {error}.") from error
    shapes = [array.shape for array in arrays]
    if shapes != [(size,) for size in sizes]:
        raise InputError(
            f"{reality.name}: {name}() gives arrays of shapes {shapes}, expected "
            f"{[(size,) for size in sizes]}."
        )
    return arrays
