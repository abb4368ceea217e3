"""`Parameters`, the physical constants of a quadrotor, and what is known of each.

`Parameters` is flat, frozen and a JAX pytree, and all of it is traced: one compilation serves every
drone. A *point* is one drone; a batch of points (leaves with a leading axis) is domain
randomization, an ensemble or a lattice. The fields that the paper's model lacks (drag, unequal
motor lag, estimator delay, battery) have neutral values, zero or one, in the named drones.
"""

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maidenflight.errors import InputError
from maidenflight.parameters import frames


@dataclass(frozen=True)
class Quantity:
    """What is known of one physical constant besides its value."""

    symbol: str
    unit: str
    """SI; "-" for a pure number."""
    lower: float
    """Smallest value with a physical meaning."""
    upper: float
    """Largest plausible value for a drone of 5 g to 5 kg."""
    meaning: str
    source: str
    """Where the model or the named drone's value comes from."""
    table: str
    """The table of the TOML file in which it stands."""
    size: int = 1
    """Number of components."""


def _quantity(
    table: str,
    symbol: str,
    unit: str,
    bounds: tuple[float, float],
    meaning: str,
    source: str,
    size: int = 1,
) -> Any:
    return field(
        metadata={"quantity": Quantity(symbol, unit, *bounds, meaning, source, table, size)}
    )


_PAPER = "Gronauer et al. 2022"
_THRUST_CURVE = "affine-quadratic curves fitted to load cells by others, such as crazyflow's"
_AUTHORS = "the authors' code (phoenix-drone-simulation c5d6907)"


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Parameters:
    """The constants of one quadrotor, in SI units.

    Leaves are floats, or arrays with any leading batch axes; vectors have a last axis of 3, and
    those of rotors (`rotor_thrust`, `rotor_x`, `rotor_y`, `rotor_direction`) of 4. `QUANTITIES`
    gives each field's unit, symbol, bounds, meaning and source.
    """

    thrust_to_weight: Any = _quantity(
        "motors",
        "k_F",
        "-",
        (1.0, 10.0),
        "thrust of all motors at full speed over weight",
        f"{_PAPER}, eq:motor-force",
    )
    thrust_offset: Any = _quantity(
        "motors",
        "c_0",
        "-",
        (-0.5, 0.5),
        "share of full thrust that does not depend on rotor speed; 0 in the paper's model",
        _THRUST_CURVE,
    )
    thrust_linear: Any = _quantity(
        "motors",
        "c_1",
        "-",
        (-1.0, 2.0),
        "share of full thrust that grows with rotor speed itself; 0 in the paper's model",
        _THRUST_CURVE,
    )
    motor_time_constant: Any = _quantity(
        "motors",
        "T_m",
        "s",
        (0.001, 1.0),
        "lag of the rotor speeds",
        f"{_PAPER}, eq:motor-dynamics",
    )
    spin_down_ratio: Any = _quantity(
        "motors",
        "T_down/T_up",
        "-",
        (0.1, 10.0),
        "lag while slowing down over lag while speeding up; 1 in the paper's model",
        "measured on load cells and from flights by others, 0.8 to 4.5",
    )
    motor_coasting: Any = _quantity(
        "motors",
        "T_c",
        "s",
        (0.0, 1.0),
        "lag of a rotor that only the air slows down, at full speed; 0 in the paper's model",
        "identified from the authors' flights of a Crazyflie: 0.12 s",
    )
    latency: Any = _quantity(
        "motors",
        "Delta",
        "s",
        (0.0, 0.05),
        "delay from command to motor",
        f"{_PAPER}, sec. Motor Model; bounds of its search",
    )
    rotor_thrust: Any = _quantity(
        "motors",
        "s",
        "-",
        (0.0, 1.5),
        "thrust of each rotor as a share of a sound one's; all 1 in the paper's model",
        "a damaged propeller; rotors in the order of the motors",
        4,
    )
    torque_to_thrust: Any = _quantity(
        "motors",
        "k_M1",
        "m",
        (0.0, 0.3),
        "reaction torque of a rotor per thrust",
        f"{_PAPER}, eq:motor-torque",
    )
    torque_offset: Any = _quantity(
        "motors",
        "k_M2",
        "N m",
        (0.0, 1e-3),
        "constant part of that torque; cancels over four rotors",
        f"{_PAPER}, eq:motor-torque",
    )
    rotor_momentum: Any = _quantity(
        "motors",
        "J_r Omega",
        "N m s",
        (0.0, 1.0),
        "angular momentum of a rotor at full speed, whose change turns the body; 0 in the paper's "
        "model",
        "Bouabdallah 2007, sec. 2.4",
    )
    actuator_noise: Any = _quantity(
        "motors",
        "sigma_u",
        "-",
        (0.0, 0.5),
        "standard deviation of the Ornstein-Uhlenbeck noise added to the thrust commands",
        f"{_AUTHORS}: 0.01/sqrt(1 - 0.85^2)",
    )
    actuator_noise_rate: Any = _quantity(
        "motors",
        "theta_u",
        "1/s",
        (0.0, 1e4),
        "how fast that noise forgets",
        f"{_AUTHORS}: -ln(0.85)/5 ms",
    )
    mass: Any = _quantity(
        "body",
        "m",
        "kg",
        (0.005, 5.0),
        "mass, battery included",
        f"{_PAPER}, table:drone-parameters",
    )
    inertia: Any = _quantity(
        "body",
        "I",
        "kg m2",
        (1e-7, 1.0),
        "diagonal of the inertia matrix: x, y, z",
        f"{_PAPER}, table:drone-parameters",
        3,
    )
    rotor_x: Any = _quantity(
        "body",
        "x_i",
        "m",
        (-1.0, 1.0),
        "place of each rotor forward of the centre of mass, in the order of the motors",
        f"{_PAPER}, table:drone-parameters: 39.6 mm from the centre, in an X",
        4,
    )
    rotor_y: Any = _quantity(
        "body",
        "y_i",
        "m",
        (-1.0, 1.0),
        "place of each rotor left of the centre of mass",
        f"{_PAPER}, table:drone-parameters: 39.6 mm from the centre, in an X",
        4,
    )
    rotor_direction: Any = _quantity(
        "body",
        "d_i",
        "-",
        (-1.0, 1.0),
        "sign of each rotor's reaction torque: 1 turns the body left, the rotor clockwise from "
        "above; -1 the other way",
        f"{_PAPER}, eq:torque",
        4,
    )
    drag: Any = _quantity(
        "body",
        "d",
        "1/s",
        (0.0, 10.0),
        "rotor drag per mass along body x, y, z; 0 in the paper's model",
        "Faessler, Franchi and Scaramuzza 2018, eq. 1",
        3,
    )
    flapping_moment: Any = _quantity(
        "body",
        "c_f",
        "N s",
        (-1.0, 1.0),
        "moment against the flight's direction per velocity; 0 in the paper's model",
        "Hoffmann et al. 2007, eq. 7-10",
    )
    rotational_damping: Any = _quantity(
        "body",
        "c_w",
        "N m s",
        (0.0, 1.0),
        "torque against roll and pitch rate per rate; 0 in the paper's model",
        "not found in flights",
    )
    torque_bias: Any = _quantity(
        "body",
        "b",
        "N m",
        (-1.0, 1.0),
        "constant torque, as of an off-centre battery or unequal motors",
        "measured from flights",
        3,
    )
    gravity: Any = _quantity(
        "body",
        "g",
        "m/s2",
        (0.1, 30.0),
        "gravitational acceleration",
        f"{_PAPER}, table:drone-parameters",
    )
    ground_effect: Any = _quantity(
        "body",
        "c_g",
        "m2",
        (0.0, 0.1),
        "gain of thrust near the ground times height squared; acts in tasks that have a floor",
        "gym-pybullet-drones: 11.37 (r/4)^2 with a propeller of r = 23.1 mm",
    )
    wind: Any = _quantity(
        "air",
        "w",
        "m/s",
        (-30.0, 30.0),
        "velocity of the air, world; 0 in the paper's model",
        "rotor drag and flapping follow the velocity through the air",
        3,
    )
    position_noise: Any = _quantity(
        "sensors", "sigma_r", "m", (0.0, 1.0), "Gaussian noise of the position", _AUTHORS
    )
    position_noise_uniform: Any = _quantity(
        "sensors", "b_r", "m", (0.0, 1.0), "half width of its uniform noise", _AUTHORS
    )
    velocity_noise: Any = _quantity(
        "sensors", "sigma_v", "m/s", (0.0, 1.0), "Gaussian noise of the velocity", _AUTHORS
    )
    position_walk: Any = _quantity(
        "sensors",
        "w_r",
        "m/sqrt(s)",
        (0.0, 1.0),
        "random walk of the estimated position, as of optical flow; 0 in the paper's model",
        "measured from flights: 0.075 for a Crazyflie's flow deck",
    )
    velocity_walk: Any = _quantity(
        "sensors",
        "w_v",
        "m/s/sqrt(s)",
        (0.0, 5.0),
        "random walk of the estimated velocity, forgotten within a second; 0 in the paper's model",
        "measured from flights: 0.083 for a Crazyflie's flow deck",
    )
    attitude_noise: Any = _quantity(
        "sensors",
        "sigma_phi",
        "rad",
        (0.0, 1.0),
        "Gaussian noise of roll, pitch, yaw",
        f"{_AUTHORS}: 0.1 deg",
    )
    attitude_noise_uniform: Any = _quantity(
        "sensors",
        "b_phi",
        "rad",
        (0.0, 1.0),
        "half width of its uniform noise",
        f"{_AUTHORS}: 0.05 deg",
    )
    gyro_noise: Any = _quantity(
        "sensors",
        "sigma_omega",
        "rad/s",
        (0.0, 5.0),
        "white noise of the body rates per sample",
        f"{_AUTHORS}: 0.088 rad/s before, 0.051 after its low-pass filter",
    )
    gyro_time_constant: Any = _quantity(
        "sensors",
        "tau_g",
        "s",
        (0.0, 0.05),
        "lag of the gyro's low-pass filter; 0 in the paper's model",
        "Crazyflie firmware: 80 Hz Butterworth, 2.8 ms",
    )
    gyro_turn_on_bias: Any = _quantity(
        "sensors",
        "b_0",
        "rad/s",
        (0.0, 1.0),
        "standard deviation of the bias at power-on",
        "Furrer et al. 2016 (RotorS), gyroscope_turn_on_bias_sigma: 0.5 deg/s",
    )
    gyro_bias_walk: Any = _quantity(
        "sensors",
        "sigma_b",
        "rad/s2/sqrt(Hz)",
        (0.0, 1.0),
        "random walk of the bias",
        "Furrer et al. 2016 (RotorS); value from the authors' code",
    )
    gyro_bias_time: Any = _quantity(
        "sensors",
        "tau_b",
        "s",
        (0.1, 1e5),
        "correlation time of the bias",
        "Furrer et al. 2016 (RotorS): 1000 s",
    )
    estimator_delay: Any = _quantity(
        "sensors",
        "Delta_e",
        "s",
        (0.0, 0.05),
        "age of the estimated position, velocity and attitude; 0 in the paper's model",
        "a Kalman filter's lag; not measured",
    )
    battery_voltage: Any = _quantity(
        "battery",
        "V_0",
        "V",
        (2.0, 60.0),
        "open-circuit voltage when the flight starts",
        "LiPo cell, full",
    )
    battery_resistance: Any = _quantity(
        "battery",
        "R_V",
        "V",
        (0.0, 10.0),
        "sag with all motors at full ratio; 0: no sag",
        "not measured",
    )
    battery_discharge: Any = _quantity(
        "battery",
        "dV/dt",
        "V/s",
        (0.0, 1.0),
        "fall of the open-circuit voltage with all motors at full ratio",
        "not measured",
    )
    time_step: Any = _quantity(
        "simulation",
        "dt",
        "s",
        (1e-5, 0.02),
        "physics step",
        f"{_PAPER}, sec. Simulation Environment: 200 Hz",
    )

    def __post_init__(self) -> None:
        # Numbers given by people become float32 once, here, so that every compiled function sees
        # one dtype.
        for name in QUANTITIES:
            value = getattr(self, name)
            if isinstance(value, float | int | tuple | list):
                object.__setattr__(self, name, np.asarray(value, dtype=np.float32))


def part_names(size: int) -> str:
    """What the parts of a vector are called: its axes, or the numbers of four motors."""
    return "xyz" if size == 3 else "1234"


QUANTITIES: dict[str, Quantity] = {
    entry.name: entry.metadata["quantity"] for entry in dataclasses.fields(Parameters)
}
"""Unit, symbol, bounds, meaning and source of every field of `Parameters`, in order."""

COMPONENTS: dict[str, tuple[str, int | None]] = {
    **{name: (name, None) for name, quantity in QUANTITIES.items() if quantity.size == 1},
    **{
        f"{name}_{axis}": (name, place)
        for name, quantity in QUANTITIES.items()
        if quantity.size > 1
        for place, axis in enumerate(part_names(quantity.size))
    },
}
"""Every single number of `Parameters` by name, such as `latency`, `inertia_x` or `rotor_thrust_1`:
its field, and its place in it if that is a vector."""


def component(parameters: Parameters, name: str) -> Any:
    """One number of a drone, by a name of `COMPONENTS`."""
    field_name, place = COMPONENTS[name]
    value = getattr(parameters, field_name)
    return value if place is None else value[..., place]


def replace(parameters: Parameters, /, **changes: Any) -> Parameters:
    """A copy with some fields changed, or single components of them such as `inertia_x`.

    Raises:
        InputError: no field has that name.
    """
    for name in changes:
        if name not in QUANTITIES and name not in COMPONENTS:
            raise InputError(f"unknown parameter {name!r}; known are {', '.join(QUANTITIES)}.")
    vectors: dict[str, list[Any]] = {}
    for name in [name for name in changes if name not in QUANTITIES]:
        field_name, place = COMPONENTS[name]
        parts = vectors.setdefault(
            field_name,
            [
                getattr(parameters, field_name)[..., axis]
                for axis in range(QUANTITIES[field_name].size)
            ],
        )
        parts[place if place is not None else 0] = changes.pop(name)
    stacked = {
        name: jnp.stack(jnp.broadcast_arrays(*parts), axis=-1) for name, parts in vectors.items()
    }
    return dataclasses.replace(parameters, **changes, **stacked)


def noiseless(parameters: Parameters) -> Parameters:
    """The same drone with perfect sensors and motors without noise."""
    sizes = [
        name
        for name in QUANTITIES
        if ("noise" in name and not name.endswith("rate")) or name.endswith("_walk")
    ]
    return replace(parameters, **dict.fromkeys([*sizes, "gyro_turn_on_bias"], np.float32(0.0)))


def check(parameters: Parameters, where: str = "parameters") -> Parameters:
    """Returns one drone's parameters if every value lies in its physical range.

    Args:
        parameters: a point, without batch axes.
        where: what the error names, usually a file.

    Raises:
        InputError: a value is not a finite number, has the wrong number of components or is out of
            range, or the rotors cannot steer the drone.
    """
    for name, quantity in QUANTITIES.items():
        value = np.asarray(getattr(parameters, name))
        if value.shape != (() if quantity.size == 1 else (quantity.size,)):
            raise InputError(
                f"{where}: {name} has shape {value.shape}, expected "
                f"{'one number' if quantity.size == 1 else f'{quantity.size} numbers'}."
            )
        if not (
            np.all(np.isfinite(value))
            and np.all(value >= quantity.lower)
            and np.all(value <= np.float32(quantity.upper))
        ):
            raise InputError(
                f"{where}: {name} = {plain(value)} {quantity.unit} is outside its physical range"
                f" [{quantity.lower:g}, {quantity.upper:g}]. Check the unit; values are SI."
            )
    return frames.check(parameters, where)


def plain(value: Any) -> Any:
    """float32 to the shortest decimal that reads back to the same float32."""
    array = np.asarray(value, dtype=np.float32)
    return [float(str(entry)) for entry in array] if array.ndim else float(str(array))
