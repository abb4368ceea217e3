"""`Bullet`, PyBullet as an `Integrator`, and `bullet_drone`, a virtual drone that it simulates.

It checks our rigid body independently and serves as an evaluation drone that none of our equations
integrate. The body is made in code, without a mesh or URDF: mass, diagonal inertia, and a force at
the place of each rotor, so that Bullet works out the torques of the lever arms. Bullet takes the
motors (`dynamics.motor_derivative`, `dynamics.rotor_forces`), their reaction torque about the body
z axis and the rotor drag; weight, gyroscopic torque, damping and the step are Bullet's own.

The body is Bullet's default kind, a multibody with a base and no links. Read back and measured
(version 3.2.7):

- A body without a shape is made without inertia; the diagonal must be set afterwards.
- The gyroscopic torque is explicit in the rates, so that free rotation gains energy at first order
  in the step. A body in maximal coordinates, the other kind, treats it implicitly and loses energy.
- Damping is 0.04 unless set: an acceleration of -0.04 (1 + |v|) v, and the same for the angular
  velocity.
- Every component of either velocity is clipped to 100 m/s or rad/s.
- The step is that of `dynamics.euler`, with an exact rotation instead of a normalised quaternion.
"""

import atexit
import threading
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax, tree
from jaxtyping import Array, ArrayLike, Float

from maidenflight.errors import imported
from maidenflight.parameters import Parameters
from maidenflight.parameters.frames import PLACES
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.realities.reality import seed_of
from maidenflight.simulator.realities.virtual_drone import VirtualDrone, virtual_drone

DAMPING = 0.04
"""Bullet's own linear and angular damping [-] (manual: changeDynamics), unless switched off."""

_PARTS = (3, 6, 10)
"""Where velocity, quaternion and body rates begin in the 13 numbers of a body, by definition of
them: position is first."""


@dataclass(frozen=True)
class Bullet:
    """PyBullet as an `Integrator`: State, delayed command, Parameters -> State.

    It works under `jit` and `vmap`, one drone after another in one Bullet world, and has no
    gradient. Between two steps the state is ours, in float32; `simulate` leaves it inside Bullet.

    Raises:
        InputError: PyBullet is not installed.
    """

    linear_damping: float = 0.0
    """Bullet's linear damping [-]; 0: off, `DAMPING`: Bullet's own."""
    angular_damping: float = 0.0
    """Bullet's angular damping [-]; 0: off, `DAMPING`: Bullet's own."""

    def __post_init__(self) -> None:
        _pybullet()

    def __call__(self, state: State, command: Float[Array, "4"], parameters: Parameters) -> State:
        """One step of `time_step`: our motors, then Bullet's rigid body under their forces."""
        rotor_speed, push = _motors(state.rotor_speed, command, parameters)
        row = jnp.concatenate([*state[:4], push, _constants(parameters)])
        moved = jax.pure_callback(
            self._moved, jax.ShapeDtypeStruct((13,), row.dtype), row, vmap_method="expand_dims"
        )
        return _state(jnp.split(moved, _PARTS), rotor_speed)

    def simulate(
        self, state: State, commands: Float[ArrayLike, "N 4"], parameters: Parameters
    ) -> State:
        """Returns a whole flight inside Bullet, in double precision.

        Args:
            state: the drone at the start.
            commands: rotor speed command sqrt(u) of each physics step, already delayed.
            parameters: the drone.

        Returns:
            The drone after each step, stacked along a first axis of N; float64.
        """
        with jax.enable_x64(True):
            state, parameters, commands = tree.map(
                lambda leaf: jnp.asarray(leaf, jnp.float64), (state, parameters, commands)
            )
            rotor_speed, pushes = _all_motors(state.rotor_speed, commands, parameters)
            constants, body = _constants(parameters), jnp.concatenate(state[:4])
        rollouts = []
        with _LOCK:
            world = _world()
            world.set_up(np.asarray(constants), self.linear_damping, self.angular_damping)
            world.put(np.asarray(body).tolist())
            for push in np.asarray(pushes).tolist():
                world.step(push)
                rollouts.append(world.read())
        return _state(np.split(np.array(rollouts), _PARTS, axis=-1), np.asarray(rotor_speed))

    def _moved(self, rows: Array) -> np.ndarray:
        """A step on the host.

        Args:
            rows: 13 numbers of the body, 8 of the motors and 23 constants each.

        Returns:
            The 13 numbers of each body after the step.
        """
        states = np.asarray(rows)
        moved = np.empty((*states.shape[:-1], 13), states.dtype)
        with _LOCK:
            world = _world()
            for index in np.ndindex(states.shape[:-1]):
                row = states[index]
                world.set_up(row[21:], self.linear_damping, self.angular_damping)
                values = row.tolist()
                world.put(values[:13])
                world.step(values[13:21])
                moved[index] = world.read()
        return moved


def bullet_drone(seed: int) -> VirtualDrone:
    """Returns the virtual drone of a seed in PyBullet, with the damping that Bullet has by default.

    Raises:
        InputError: the seed is negative, or PyBullet is not installed.
    """
    engine = Bullet(DAMPING, DAMPING)
    return replace(virtual_drone(seed), name=f"pybullet:{seed}", integrator=engine)


def named_drone(seed: str) -> VirtualDrone:
    """Returns the drone of `pybullet:SEED`; see `bullet_drone`."""
    return bullet_drone(seed_of(f"pybullet:{seed}"))


class _World:
    """One Bullet world with one body in it, of plain numbers.

    Slow settings are repeated only when they change.
    """

    def __init__(self) -> None:
        self.bullet = _pybullet()
        self.client = {"physicsClientId": self.bullet.connect(self.bullet.DIRECT)}
        atexit.register(self.bullet.disconnect, **self.client)
        self.body = self.bullet.createMultiBody(baseMass=1.0, **self.client)
        self.settings: tuple[Any, ...] = ()

    def set_up(
        self, constants: Float[np.ndarray, "23"], linear_damping: float, angular_damping: float
    ) -> None:
        """Makes the body this drone's; `constants` are those of `_constants`."""
        settings = (constants.tobytes(), linear_damping, angular_damping)
        if settings == self.settings:
            return
        values = constants.tolist()
        mass, ix, iy, iz = values[:4]
        drag, self.flapping = values[4:7], values[7:9]
        self.damping, gravity, self.time_step = values[9:12]
        self.wind = values[12:15]
        self.places = [[x, y, 0.0] for x, y in zip(values[15:19], values[19:23], strict=True)]
        self.drag = [mass * share for share in drag]
        self.bullet.setGravity(0.0, 0.0, -gravity, **self.client)
        self.bullet.setTimeStep(self.time_step, **self.client)
        damping = {"linearDamping": linear_damping, "angularDamping": angular_damping}
        self.bullet.changeDynamics(
            self.body, -1, mass=mass, localInertiaDiagonal=(ix, iy, iz), **damping, **self.client
        )
        self.settings = settings

    def put(self, body: list[float]) -> None:
        """Puts the body where the drone is; Bullet's angular velocity is along world axes."""
        quaternion = body[6:10]
        self.bullet.resetBasePositionAndOrientation(self.body, body[:3], quaternion, **self.client)
        self.bullet.resetBaseVelocity(
            self.body, body[3:6], self.bullet.rotateVector(quaternion, body[10:]), **self.client
        )

    def step(self, push: list[float]) -> None:
        """Takes one step under what `_motors` says, drag, flapping and damping.

        A step of no time, where a command arrives with another, is none.
        """
        if self.time_step == 0.0:
            return
        bullet, frame = self.bullet, self.bullet.LINK_FRAME
        forces, further, precession = push[:4], push[4:7], push[7]
        for force, arm in zip(forces, self.places, strict=True):
            bullet.applyExternalForce(self.body, -1, (0.0, 0.0, force), arm, frame, **self.client)
        bullet.applyExternalTorque(self.body, -1, further, frame, **self.client)
        if any(self.drag) or any(self.flapping) or self.damping or precession:
            x, y, z, w = bullet.getBasePositionAndOrientation(self.body, **self.client)[1]
            moving, turning = bullet.getBaseVelocity(self.body, **self.client)
            through_air = [of - air for of, air in zip(moving, self.wind, strict=True)]
            velocity, rates = (
                bullet.rotateVector((-x, -y, -z, w), vector) for vector in (through_air, turning)
            )
            slowing = [-share * speed for share, speed in zip(self.drag, velocity, strict=True)]
            bullet.applyExternalForce(self.body, -1, slowing, (0.0, 0.0, 0.0), frame, **self.client)
            pitching = (
                self.flapping[0] * velocity[1] - self.damping * rates[0] + precession * rates[1],
                -self.flapping[1] * velocity[0] - self.damping * rates[1] - precession * rates[0],
                0.0,
            )
            bullet.applyExternalTorque(self.body, -1, pitching, frame, **self.client)
        bullet.stepSimulation(**self.client)

    def read(self) -> list[float]:
        """Returns position, velocity, quaternion, body rates."""
        position, quaternion = self.bullet.getBasePositionAndOrientation(self.body, **self.client)
        velocity, spin = self.bullet.getBaseVelocity(self.body, **self.client)
        x, y, z, w = quaternion
        return [*position, *velocity, *quaternion, *self.bullet.rotateVector((-x, -y, -z, w), spin)]


_LOCK = threading.Lock()
"""One drone at a time: XLA calls back from threads of its own, and a Bullet world has one state."""


@lru_cache(maxsize=1)
def _world() -> _World:
    return _World()


def _pybullet() -> Any:
    """The package, imported when first needed."""
    remark = "compiled by pip in many minutes, except for Python 3.11 on Linux"
    return imported("pybullet", "pybullet", "this drone", remark)


def _motors(
    rotor_speed: Float[Array, "4"], command: Float[Array, "4"], parameters: Parameters
) -> tuple[Float[Array, "4"], Float[Array, "8"]]:
    """Rotor speeds after a step of `dynamics.euler`, and what they push with.

    Returns:
        Rotor speeds, and four forces [N], the torque that these do not make [N m], and the
        rotors' angular momentum with the signs of their drag [N m s].
    """
    spin_up = dynamics.motor_derivative(rotor_speed, command, parameters)
    rotor_speed = rotor_speed + parameters.time_step * spin_up
    forces = dynamics.rotor_forces(rotor_speed, parameters)
    # What depends on velocities is left to the world's step.
    still = State(*(jnp.zeros(size, rotor_speed.dtype) for size in (3, 3, 4, 3, 4)))
    still = still._replace(velocity=jnp.asarray(parameters.wind, rotor_speed.dtype))
    *about_x_and_y, yaw = dynamics.further_torque(still, forces, spin_up, parameters)
    yaw = yaw + dynamics.torque(forces, parameters)[2]
    momentum = parameters.rotor_momentum * rotor_speed @ parameters.rotor_direction
    return rotor_speed, jnp.stack([*forces, *about_x_and_y, yaw, momentum])


@jax.jit
def _all_motors(
    rotor_speed: Float[Array, "4"], commands: Float[Array, "N 4"], parameters: Parameters
) -> tuple[Float[Array, "N 4"], Float[Array, "N 8"]]:
    """`_motors` over a whole flight; the motors do not depend on how the body moves."""

    def step_motors(rotor_speed: Array, command: Array) -> tuple[Array, tuple[Array, Array]]:
        moved = _motors(rotor_speed, command, parameters)
        return moved[0], moved

    return lax.scan(step_motors, rotor_speed, commands)[1]


def _state(parts: Any, rotor_speed: Any) -> State:
    position, velocity, quaternion, body_rates = parts
    return State(position, velocity, quaternion, body_rates, rotor_speed)


def _constants(parameters: Parameters) -> Float[Array, "23"]:
    """Mass, inertia, drag, flapping, damping, gravity, time step, wind and rotors' places."""
    names = (
        "mass",
        "inertia",
        "drag",
        "flapping_moment",
        "rotational_damping",
        "gravity",
        "time_step",
        "wind",
        *PLACES,
    )
    return jnp.concatenate([jnp.ravel(getattr(parameters, name)) for name in names])
