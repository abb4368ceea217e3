"""What a linear regulator makes of attitude control about a drone, with the same delay and rate.

The simulated drone, the firmware's loops at 500 Hz, estimator and delay line are linear near hover:
their derivatives over one action are exact, by automatic differentiation. Prints the phase that the
rate loop has left, the pole that grows fastest from action to action, the margins of the regulator
that knows all of that state and pays most for its actions, and its flights of 20 s from 2 cm beside
a set-point, with the drone's noise.

    python paper/policies/attitude_bound.py virtual:43 virtual:43+10ms

Source: Anderson and Moore 1990, Optimal control, sec. 5.4 (margins of a regulator by the largest
singular value of its sensitivity).
"""

import argparse
from collections.abc import Callable
from dataclasses import replace as replaced
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float
from scipy.linalg import solve_discrete_are

from maidenflight import compiler
from maidenflight.experiments.drones import find_reality
from maidenflight.parameters import Parameters, noiseless, replace
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.controllers.phase_margin import rate_margin
from maidenflight.simulator.environment import Environment, EnvState
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.realities.virtual_drone import must_be_virtual
from maidenflight.simulator.tasks import tasks
from maidenflight.training.defaults import choose_controller

PARTS = ("state", "delay_line", "controller", "gyro", "estimator", "measurement")
"""Of an environment's state, what moves the drone."""
PRICE = 100.0
"""Of an action's square, beside those of 10 cm, 0.5 m/s and 0.3 rad: ten times as much changes no
phase margin by a twentieth."""
AWAY_M, LOST_M, SECONDS, FLIGHTS = 0.02, 0.25, 20.0, 4


class Hover(NamedTuple):
    """A drone about hover."""

    env: Environment
    drone: Parameters
    linear: Parameters
    """The same without noise, and with one lag for both directions."""
    level: Float[Array, "4"]
    """Action that hovers it."""

    def begin(self, drone: Parameters, away: float, key: Array) -> EnvState:
        """Returns the first state, beside the set-point."""
        place = self.env.task.reference(jnp.zeros(())) + jnp.array([away, 0.0, 0.0])
        return environment.begin(
            self.env, dynamics.at_hover(place, drone), jnp.zeros(()), drone, key
        )


def hover_of(name: str, structure: str) -> Hover:
    """Returns a virtual drone about hover; without its battery, whose PWM has steps."""
    reality = must_be_virtual(find_reality(name), "Name a virtual one.")
    drone = replace(reality.parameters, torque_bias=np.zeros(3, np.float32))
    lag = dynamics.equivalent_lag(drone.motor_time_constant, drone.spin_down_ratio)
    one = np.float32(1.0)
    linear = replace(noiseless(drone), motor_time_constant=np.float32(lag), spin_down_ratio=one)
    controller = choose_controller(structure, drone)
    env = reality.environment(tasks.find_task("hover"), controller)
    env = replaced(env, battery=False, thrust_law=None)
    level = controller.interface.level(dynamics.hover_command(drone))
    return Hover(env, drone, linear, jnp.asarray(level))


def vector_of(state: EnvState) -> tuple[Float[Array, "n"], Callable[[Array], EnvState]]:
    """Returns the numbers that move the drone, and what puts others into the state."""
    parts = {name: getattr(state, name) for name in PARTS}
    leaves, structure = jax.tree.flatten(parts)
    moving = [jnp.issubdtype(jnp.asarray(leaf).dtype, jnp.floating) for leaf in leaves]
    vector, separate = ravel_pytree(
        [leaf for leaf, moves in zip(leaves, moving, strict=True) if moves]
    )

    def into(numbers: Array) -> EnvState:
        new = iter(separate(numbers))
        every = [next(new) if moves else leaf for leaf, moves in zip(leaves, moving, strict=True)]
        return state._replace(**jax.tree.unflatten(structure, every))

    return vector, into


def linearised(hover: Hover) -> tuple[np.ndarray, np.ndarray, np.ndarray, Array]:
    """Returns the transition of an action, what the action adds, outputs, and the still state."""
    key = jax.random.key(0)

    def move(state: EnvState, action: Array) -> EnvState:
        return stepping.step(hover.env, state, action, hover.linear, key)[0]

    # Two actions fill the estimator's memory and stop what begins.
    state = hover.begin(hover.linear, 0.0, key)
    for _ in range(2):
        state = jax.jit(move)(state, hover.level)
    still, into = vector_of(state)

    def after(numbers: Array, action: Array) -> Array:
        return vector_of(move(into(numbers), action))[0]

    def outputs(numbers: Array) -> Array:
        one = into(numbers).state
        return jnp.concatenate(
            [one.position / 0.1, one.velocity / 0.5, 2.0 * one.quaternion[:3] / 0.3]
        )

    step, drive = jax.jit(jax.jacfwd(after, (0, 1)))(still, hover.level)
    seen = jax.jit(jax.jacfwd(outputs))(still)
    return *(np.asarray(one, float) for one in (step, drive, seen)), still  # type: ignore[return-value]


def reachable(step: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Returns an orthonormal basis of the states that actions can reach."""
    basis = np.linalg.qr(drive)[0]
    while True:
        left, sizes, _ = np.linalg.svd(np.hstack([basis, step @ basis]), full_matrices=False)
        count = int((sizes > 1e-7 * sizes[0]).sum())
        if count == basis.shape[1]:
            return basis
        basis = left[:, :count]


def regulator(step: np.ndarray, drive: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Returns the gain from a state to the action that it is answered by."""
    price = PRICE * np.eye(drive.shape[1])
    weight = seen.T @ seen + 1e-9 * np.eye(len(step))
    cost = solve_discrete_are(step, drive, weight, price)
    return np.linalg.solve(price + drive.T @ cost @ drive, drive.T @ cost @ step)


def margins(step: np.ndarray, drive: np.ndarray, gain: np.ndarray) -> tuple[float, float]:
    """Returns the least gain and phase [deg] margin of a regulator at its actions."""
    size, peak = drive.shape[1], 0.0
    for angle in np.linspace(1e-3, np.pi, 2000):
        loop = gain @ np.linalg.solve(np.exp(1j * angle) * np.eye(len(step)) - step, drive)
        peak = max(peak, float(np.linalg.svd(np.linalg.inv(np.eye(size) + loop))[1][0]))
    return peak / (peak - 1.0), float(np.degrees(2.0 * np.arcsin(0.5 / peak)))


def fly(hover: Hover, gain: np.ndarray, still: Array) -> list[tuple[float, float]]:
    """Returns how long each flight lasts [s], and its mean error [m]."""
    answer, rate = jnp.asarray(gain, jnp.float32), hover.env.controller.interface.rate
    place = hover.env.task.reference(jnp.zeros(()))

    def one(state: EnvState, key: Array) -> tuple[EnvState, Any]:
        action = hover.level - answer @ (vector_of(state)[0] - still)
        state = stepping.step(hover.env, state, jnp.clip(action, -1, 1), hover.drone, key)[0]
        return state, jnp.linalg.norm(state.state.position - place)

    @jax.jit
    def flight(key: Array) -> Array:
        keys = jax.random.split(key, round(SECONDS * rate) + 1)
        return jax.lax.scan(one, hover.begin(hover.drone, AWAY_M, keys[0]), keys[1:])[1]

    found = []
    for number in range(FLIGHTS):
        errors = np.asarray(flight(jax.random.key(number)))
        end = int(np.argmax(~(errors < LOST_M))) if not np.all(errors < LOST_M) else len(errors)
        found.append((end / rate, float(errors[:end].mean()) if end else np.nan))
    return found


def main() -> None:
    """Prints a line a drone."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("drones", nargs="+")
    parser.add_argument("--control", default="attitude")
    options = parser.parse_args()
    for name in options.drones:
        hover = hover_of(name, options.control)
        counts = hover.env.controller.interface.full_scale_counts
        left = np.degrees(rate_margin(hover.drone, counts).phase)
        step, drive, seen, still = linearised(hover)
        basis = reachable(step, drive)
        small = basis.T @ step @ basis, basis.T @ drive, seen @ basis
        gain = regulator(*small)
        times, phase = margins(*small[:2], gain)
        flights = fly(hover, gain @ basis.T, still)
        poles = np.linalg.eigvals(small[0])
        print(
            f"{name}: rate loop {left:.0f} deg; a pole of {np.abs(poles).max():.2f} an action; "
            f"regulator: gain {times:.1f}, phase {phase:.0f} deg; flights "
            + ", ".join(f"{seconds:.1f} s {100 * error:.1f} cm" for seconds, error in flights),
            flush=True,
        )


if __name__ == "__main__":
    compiler.prepare_jax()
    main()
