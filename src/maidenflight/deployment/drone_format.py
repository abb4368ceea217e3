"""Drones in formats of other programs: what each holds, and what it cannot, as comments.

A `DroneFormat` says which drone of our model its program simulates, the nearest one that the format
holds. All that differs from the drone itself is written as comments with values, so that nothing is
lost silently.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight import __version__, parameters, results
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.parameters import QUANTITIES, Parameters, plain
from maidenflight.registry import DRONE_FORMATS
from maidenflight.simulator.physics import dynamics

TABLES = ("motors", "body", "air")
"""Of the quantities that a program may simulate; sensors and battery are not the drone's model."""
NOISE = ("actuator_noise", "actuator_noise_rate")
"""Of the motors, but random."""
NEUTRAL = {"rotor_thrust": 1.0, "spin_down_ratio": 1.0}
"""Values that stand for nothing where it is not 0, by definition."""
RPM = 60.0 / (2.0 * np.pi)
"""Revolutions a minute of a rad/s, by definition."""
SLOWEST_RPM, FASTEST_RPM = 100.0, 200e3
"""Between which a rotor's full speed lies; chosen wide."""


@dataclass(frozen=True)
class DroneModel:
    """A drone that a format holds, and what is written beside it."""

    name: str
    """What to call it."""
    drone: Parameters
    """The nearest drone that the format holds; NaN where it does not hold a quantity at all."""
    original: Parameters
    """The drone itself."""
    full_speed: float = float("nan")
    """Rotor speed of the original at u = 1 [rad/s]; NaN where it is not known."""
    samples: Sequence[Parameters] = ()
    """Drones of the posterior."""
    record: Mapping[str, Any] = field(default_factory=dict)
    """How the file is made; see `results.record`."""
    remarks: Sequence[str] = ()
    """Sentences of the format for its users."""

    @property
    def thrusts(self) -> Float[np.ndarray, "4"]:
        """Thrust of each rotor at u = 1 [N]."""
        drone = self.original
        share = np.asarray(drone.rotor_thrust, np.float64)
        return share * float(drone.mass * drone.gravity * drone.thrust_to_weight) / 4

    @property
    def hover_speed(self) -> float:
        """Rotor speed at hover [rad/s]."""
        return self.full_speed * float(np.sqrt(dynamics.hover_command(self.original)))

    @property
    def square_speed(self) -> float:
        """Speed at full thrust [rad/s] of rotors whose thrust is quadratic and right at hover."""
        return self.hover_speed * float(np.sqrt(self.original.thrust_to_weight))

    def comments(self) -> list[str]:
        """Returns what the file says of itself, a line each: origin, remarks, what is lost."""
        lines = [f"{self.name}, by maidenflight {__version__}", *self.remarks]
        lost = losses(self.original, self.drone)
        if lost:
            lines += ["This format does not hold, SI units:", *lost]
        return lines + [f"record: {self.record}"] * bool(self.record)


class DroneFormat(NamedTuple):
    """A format of another program for drones."""

    ending: str
    """Of its files, such as `.xml`."""
    nearest: Callable[[Parameters], Parameters]
    """Returns the nearest drone that the format holds."""
    write: Callable[[DroneModel], str]
    """Returns a file's text."""
    remarks: tuple[str, ...] = ()
    """Sentences for users, such as what a command is."""
    needs_speed: bool = False
    """Whether it needs the rotors' speed at u = 1."""


def simplest(drone: Parameters) -> Parameters:
    """Returns the drone with what every rigid body with four rotors has.

    Thrust is quadratic in the rotor speed, and speeds lag by the equivalent of both ways. There is
    no latency, drag or trim. What cancels over four rotors stays.
    """
    turning = float(np.sum(np.asarray(drone.rotor_direction)))
    offset = 0.0 if turning else drone.torque_offset
    zero = ("thrust_offset", "thrust_linear", "motor_coasting", "latency", "rotor_momentum")
    further = ("rotational_damping", "ground_effect", "actuator_noise", "actuator_noise_rate")
    vectors = ("drag", "torque_bias", "wind")
    return parameters.replace(
        drone,
        **dict.fromkeys((*zero, *further), np.float32(0.0)),
        **dict.fromkeys(vectors, np.zeros(3, np.float32)),
        torque_offset=offset,
        flapping_moment=np.zeros(2, np.float32),
        rotor_thrust=np.ones(4, np.float32),
        motor_time_constant=np.float32(
            dynamics.equivalent_lag(drone.motor_time_constant, drone.spin_down_ratio)
        ),
        spin_down_ratio=np.float32(1.0),
    )


def losses(drone: Parameters, nearest: Parameters) -> list[str]:
    """Returns a line for each quantity that another drone does not have as this one: its value."""
    lines = []
    for name, quantity in QUANTITIES.items():
        value, other = (np.asarray(getattr(model, name), np.float64) for model in (drone, nearest))
        is_off = np.all(value == NEUTRAL.get(name, 0.0))
        if quantity.table not in TABLES or name in NOISE or is_off:
            continue
        if not np.allclose(value, other, rtol=1e-6, atol=0.0):
            lines.append(f"{name} = {plain(value)} {quantity.unit}: {quantity.meaning}")
    return lines


def drone_text(
    drone: Parameters,
    to: str,
    name: str = "drone",
    *,
    full_speed: float | None = None,
    samples: Sequence[Parameters] = (),
    record: Mapping[str, Any] | None = None,
) -> str:
    """Returns a drone as the text of another program's file.

    Args:
        drone: a point.
        to: a name in `registry.DRONE_FORMATS`.
        name: what to call it.
        full_speed: of the rotors at u = 1 [rpm]; formats with rotor speeds need it.
        samples: drones of its posterior, for formats with ranges.
        record: how the file is made.

    Raises:
        InputError: no such format, its package is damaged, or the speed is lacking or none.
    """
    kind: DroneFormat = DRONE_FORMATS[to]
    if kind.needs_speed and full_speed is None:
        raise InputError(
            f"{to} has rotor speeds, and {name} does not say how fast its rotors turn at full "
            "command. Give --full-speed RPM. Where you do not know it, any speed gives the same "
            "flights: only shares of it matter, as in --full-speed 20000."
        )
    if full_speed is not None and not SLOWEST_RPM <= full_speed <= FASTEST_RPM:
        raise InputError(
            f"full speed {full_speed:g} rpm: expected {SLOWEST_RPM:g} to {FASTEST_RPM:g} rpm."
        )
    speed = float("nan") if full_speed is None else full_speed / RPM
    point = parameters.check(drone, name)
    model = DroneModel(
        name, kind.nearest(point), point, speed, tuple(samples), record or {}, kind.remarks
    )
    return kind.write(model)


def export_drone(drone: Parameters, path: StrPath, to: str, **options: Any) -> Path:
    """Writes a drone for another program, such as a simulator.

    Args:
        drone: a point.
        path: the file to write.
        to: a name in `registry.DRONE_FORMATS`, such as `mjcf`.
        **options: of `drone_text`; its name is the file's by default.

    Returns:
        The path.

    Raises:
        InputError: see `drone_text`; or the file cannot be written.
    """
    options.setdefault("name", Path(path).stem)
    return results.write(path, drone_text(drone, to, **options))


def xml_comment(lines: Sequence[str]) -> str:
    """Returns lines as one comment of XML, in which no two hyphens may follow each other."""
    text = "\n".join(f"  {line}" for line in lines)
    while "--" in text:
        text = text.replace("--", "- -")
    return f"<!--\n{text}\n-->\n"


def hash_comment(lines: Sequence[str]) -> str:
    """Returns lines as comments that begin with `#`."""
    return "".join(f"# {line}\n" for line in lines)


def digits(*values: Any) -> str:
    """Returns numbers as the shortest decimals of their float32, with spaces between them."""
    return " ".join(f"{rounded(value):.9g}" for array in values for value in np.ravel(array))


def rounded(value: Any) -> float:
    """Returns the shortest decimal of a number's float32; of minus zero, zero."""
    return float(str(np.float32(value))) + 0.0
