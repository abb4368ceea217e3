"""`PolicySpec`: what a policy sees and remembers, and the hidden layers of its network.

Whatever trains, flies or exports policies takes it as one value, beside the `ControlInterface`,
which says what they command.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from typing import Any, ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from maidenflight.errors import InputError
from maidenflight.registry import POLICY_FORMS
from maidenflight.simulator.controllers.interface import ControlInterface, pwm
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.tasks import look_ahead
from maidenflight.simulator.tasks.look_ahead import LookAhead
from maidenflight.simulator.tasks.trajectories import Trajectory


def _same(values: Any) -> Any:
    return values


@dataclass(frozen=True, eq=False)
class PolicyForm:
    """What a network of another shape than ours sees and commands; as it stands, that of ours.

    Whatever flies policies gives one of any form an observation of ours, and takes an action of
    ours.
    """

    name: str
    settled: Mapping[str, Any] = field(default_factory=dict)
    """Fields of a `PolicySpec` that the form settles."""
    inputs: int | None = None
    """Numbers that the network sees; those of an observation by default."""
    scaling: tuple[Float[np.ndarray, "inputs"], Float[np.ndarray, "inputs"]] | None = None
    """Means and deviations by which a new policy scales them; those of its spec by default."""
    through_memory: bool = False
    """Whether the second layer sees the memory alone."""
    first_bias: float = 0.0
    """Of the first layer of a new policy."""
    observed: Callable[[Float[Array, "20H+3K"]], Float[Array, "inputs"]] = _same
    """What the network sees of an observation without its memory."""
    action_of: Callable[[Float[Array, "4"]], Float[Array, "4"]] = _same
    """The action that commands what an output does."""
    output_of: Callable[[Float[ArrayLike, "4"]], Float[ArrayLike, "4"]] = _same
    """The output that commands what an action does."""
    check: Callable[[ControlInterface, str], None] = lambda commanded, source: None
    """Refuses interfaces that such policies cannot command; the text is what errors name."""
    methods: tuple[str, ...] = ("distillation", "gradient", "ppo")
    """By which they are trained, in `names.METHODS`; the first where there is a memory."""
    learning: Mapping[str, Any] = field(default_factory=dict)
    """Settings of gradients that differ from those of other policies with a memory."""

    def check_method(self, method: str) -> None:
        """Refuses a method by which such policies are not trained.

        Raises:
            InputError: as above.
        """
        if method not in self.methods:
            raise InputError(
                f"policies of the form {self.name} are trained by {' or '.join(self.methods)}, not "
                f"by {method}."
            )


def require_pwm(form: str, commanded: ControlInterface, source: str = "policy") -> None:
    """Checks that an interface is the motors', as policies of a form command it.

    Args:
        form: its name.
        commanded: what they command.
        source: what errors name, such as the file.

    Raises:
        InputError: it is another.
    """
    usual = pwm(full_scale_counts=commanded.full_scale_counts)
    if commanded != usual:
        raise InputError(
            f"{source}: {commanded.name} at {commanded.rate} Hz; a policy of the form {form} has "
            f"pwm at {usual.rate} Hz."
        )


OURS = PolicyForm("instants")
"""Of a policy whose network sees observations as they are, and gives actions."""


def form_of(name: str) -> PolicyForm:
    """Returns a form by name, `instants` or one of `registry.POLICY_FORMS`.

    Raises:
        InputError: there is no such form.
    """
    if name == OURS.name:
        return OURS
    if not isinstance(name, str) or name not in POLICY_FORMS:
        forms = ", ".join([OURS.name, *POLICY_FORMS])
        raise InputError(f"form = {name!r}, expected one of {forms}.")
    return POLICY_FORMS[name]


ACTION_SIZE = 4
OBSERVATION_SIZE = 20
"""Size of one instant's observation: position 3, quaternion 4, velocity 3, body rates 3, position
error 3, last action 4."""
INSTANT = (
    "position 3, quaternion xyzw 4, velocity 3, body rates 3, setpoint - position 3, last "
    "action 4; oldest first"
)
"""Order of the numbers of an instant, for files."""
INSTANTS = OURS.name
"""Form of a policy whose network sees observations as they are, and gives actions."""
MOST_INSTANTS = 1000
MOST_MEMORY = 256
"""Numbers of a memory at most."""

ANYWHERE_M = 1e3
"""By which positions are scaled where a policy looks ahead [m]: far beyond any room."""

_MEAN = (
    *(0.25, 0.0, 1.0),  # position
    *(0.0, 0.0, 0.0, 1.0),  # quaternion
    *(0.0, 0.0, 0.0),  # velocity
    *(0.0, 0.0, 0.0),  # body rates
    *(0.0, 0.0, 0.0),  # setpoint - position
    *(0.2, 0.2, 0.2, 0.2),  # last action
)
_DEVIATION = (
    *(0.2, 0.2, 0.2),
    *(0.1, 0.1, 0.1, 0.05),
    *(0.4, 0.4, 0.4),
    *(1.0, 1.0, 1.0),
    *(0.1, 0.1, 0.1),
    *(0.5, 0.5, 0.5, 0.5),
)


@dataclass(frozen=True)
class PolicySpec:
    """Describes a kind of policies; hashable, for use as a static argument.

    Fields that its form settles are as the form says, whatever the arguments.

    Raises:
        InputError: a field is out of range, or there is a memory without a hidden layer.
    """

    history: int = 2
    """H, observed instants in an observation (Gronauer et al. 2022, sec. Simulation
    Environment)."""
    look_ahead: LookAhead = look_ahead.NONE
    """The K points of the reference ahead of time, behind the last instant."""
    memory: int = 0
    """M, numbers of a gated recurrent unit behind the first layer; 0: none. An observation ends
    with them, and an output with what is remembered next."""
    hidden: tuple[int, ...] = (50, 50)
    """Sizes of the hidden layers (Gronauer et al. 2022, sec. Zero-Shot Experiments)."""
    form: str = INSTANTS
    """`INSTANTS`, or one of `registry.POLICY_FORMS`."""

    OF_NETWORK: ClassVar = ("memory", "hidden")
    """Fields that the arrays of a network tell, so that policy files do not repeat them."""
    OBSERVED: ClassVar = ("history", "look_ahead")
    """Fields that say what is observed of a flight, whatever the network."""

    def __post_init__(self) -> None:
        """Settles what the form settles, and checks all fields."""
        form = self.policy_form
        if not isinstance(self.look_ahead, LookAhead):
            raise InputError(f"look_ahead = {self.look_ahead!r}; expected such as LookAhead(5).")
        settled: dict[str, Any] = {} if self.look_ahead.points else {"look_ahead": look_ahead.NONE}
        for name, value in (settled | dict(form.settled)).items():
            object.__setattr__(self, name, value)
        if type(self.history) is not int or not 1 <= self.history <= MOST_INSTANTS:
            raise InputError(
                f"history = {self.history!r}; expected a whole number of instants, 1 to "
                f"{MOST_INSTANTS}. The paper's policies see 2."
            )
        if type(self.memory) is not int or not 0 <= self.memory <= MOST_MEMORY:
            raise InputError(
                f"memory = {self.memory!r}; expected a whole number, 0 to {MOST_MEMORY}."
            )
        sizes = self.hidden
        if type(sizes) is not tuple or any(type(size) is not int or size < 1 for size in sizes):
            raise InputError(f"hidden = {sizes!r}; expected sizes of layers, such as (50, 50).")
        if self.memory and not self.hidden:
            raise InputError("memory without a hidden layer; give hidden layers, such as (50, 50).")

    @property
    def policy_form(self) -> PolicyForm:
        """What the form means."""
        return form_of(self.form)

    @property
    def size(self) -> int:
        """Numbers of an observation, what is remembered included."""
        return self.observed_size + self.memory

    @property
    def observed_size(self) -> int:
        """Numbers of an observation before what is remembered."""
        return OBSERVATION_SIZE * self.history + self.look_ahead.size

    @property
    def layer_sizes(self) -> tuple[int, ...]:
        """Sizes of input, hidden layers and output, such as (40, 50, 50, 4)."""
        return (self.policy_form.inputs or self.observed_size, *self.hidden, ACTION_SIZE)

    @property
    def scaling(self) -> tuple[Float[np.ndarray, "inputs"], Float[np.ndarray, "inputs"]]:
        """Means and deviations by which a new policy scales what its network sees [SI]."""
        if self.policy_form.scaling is not None:
            return self.policy_form.scaling
        mean, deviation = (
            np.tile(np.array(values, np.float32), self.history) for values in (_MEAN, _DEVIATION)
        )
        ahead = self.look_ahead.deviations
        if self.look_ahead.points:
            # Where the drone is says nothing of where it shall go, so a new place changes nothing.
            deviation.reshape(self.history, -1)[:, :3] = ANYWHERE_M
        return np.concatenate([mean, np.zeros_like(ahead)]), np.concatenate([deviation, ahead])

    @property
    def layout(self) -> str:
        """Order of an observation, in words for a file."""
        ahead = self.look_ahead
        text = f"{self.history} instants of {OBSERVATION_SIZE} numbers: {INSTANT}"
        return text + (
            f"; then {ahead.points} x 3: where the set-point will be {ahead.spacing:g} s, "
            f"{2 * ahead.spacing:g} s, ... later - position"
            if ahead.points
            else ""
        )

    @property
    def identity(self) -> str:
        """Text that tells it from others; random numbers of predicted flights depend on it."""
        ahead = self.look_ahead
        text = f"{self.history} {self.layer_sizes}"
        text += f" {ahead.points} {ahead.spacing}" if ahead.points else ""
        return text + (f" memory {self.memory}" if self.memory else "")

    def points(self, reference: Trajectory, time: Float[Array, ""]) -> Float[Array, "K 3"]:
        """Returns where a reference will be at the points ahead of a time [s], world [m]."""
        return self.look_ahead.of(reference, time) if self.look_ahead.points else jnp.zeros((0, 3))

    def observation(
        self,
        history: Float[Array, "H 20"],
        points: Float[Array, "K 3"],
        position: Float[Array, "3"],
        memory: Float[Array, "M"],
    ) -> Float[Array, "20H+3K+M"]:
        """Joins an observation.

        Args:
            history: the last H instants, oldest first.
            points: see `points`.
            position: measured, world [m].
            memory: what the policy remembers.
        """
        observed_part = self.join_observed(history, points, position)
        return jnp.concatenate([observed_part, memory]) if self.memory else observed_part

    def join_observed(
        self,
        history: Float[Array, "H 20"],
        points: Float[Array, "K 3"],
        position: Float[Array, "3"],
    ) -> Float[Array, "20H+3K"]:
        """Joins what an observation holds before what is remembered; see `observation`."""
        values = history.reshape(-1)
        if self.look_ahead.points:
            return jnp.concatenate([values, (points - position[None]).reshape(-1)])
        return values

    def beyond(self, *known: str) -> str:
        """Returns the names what sets it apart from the paper's policies, with values.

        Empty if nothing does.

        For consumers that can do without some of it: what is added to this class later they refuse.

        Args:
            known: names of fields that may differ.
        """
        differences = {name: value for name, value in self._unusual().items() if name not in known}
        return ", ".join(f"{name} = {value}" for name, value in differences.items())

    def to_dict(self) -> dict[str, Any]:
        """Returns plain values for files and records.

        History and hidden layers, and what the paper's policies do not have.
        """
        return {"history": self.history, **self._unusual(), "hidden": list(self.hidden)}

    def _unusual(self) -> dict[str, Any]:
        usual = type(self)()
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asdict(self).items()
            if getattr(self, name) != getattr(usual, name)
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        """Reads what `to_dict` gave; a mapping may hold entries of other names, too.

        Raises:
            InputError: a field is not what it should be, or not what the form has.
        """
        options = {field.name: content.get(field.name, field.default) for field in fields(cls)}
        if "look_ahead" in content:
            options["look_ahead"] = LookAhead.from_dict(options["look_ahead"])
        if isinstance(options["hidden"], list):
            options["hidden"] = tuple(options["hidden"])
        spec = cls(**options)
        wrong = [name for name, value in options.items() if getattr(spec, name) != value]
        if wrong and spec.policy_form.settled:
            raise InputError(
                f"{', '.join(f'{name} = {options[name]}' for name in wrong)}; a policy of the form "
                f"{spec.form} has {', '.join(f'{name} = {getattr(spec, name)}' for name in wrong)}."
            )
        return spec


def observe(
    measurement: Measurement, setpoint: Float[Array, "3"], action: Float[Array, "4"]
) -> Float[Array, "20"]:
    """Returns one instant of an observation, in the order of `INSTANT`.

    Source: Gronauer et al. 2022, sec. Simulation Environment; the order and the sign of the error
    are those of the authors' code and firmware (the paper writes e = r - t).
    """
    error = setpoint - measurement.position
    values = (
        measurement.position,
        measurement.quaternion,
        measurement.velocity,
        measurement.body_rates,
    )
    return jnp.concatenate([*values, error, action])


def remember(history: Float[Array, "H 20"], instant: Float[Array, "20"]) -> Float[Array, "H 20"]:
    """Returns the history with one more instant and without its oldest."""
    return jnp.concatenate([history[1:], instant[None]])


@partial(jax.jit, static_argnums=(0, 1))
def points_at(
    spec: PolicySpec, reference: Trajectory, time: Float[ArrayLike, ""]
) -> Float[Array, "K 3"]:
    """Computes `PolicySpec.points`, compiled, for policies that fly one instant at a time."""
    return spec.points(reference, jnp.asarray(time, jnp.float32))
