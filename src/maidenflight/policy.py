"""`Policy`, a network with all that is needed to fly it, and `Actor`, which flies it."""

import dataclasses
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from maidenflight.errors import InputError
from maidenflight.registry import PLOTS
from maidenflight.simulator.controllers import interface as interfaces
from maidenflight.simulator.controllers.interface import ControlInterface
from maidenflight.simulator.gru import Gru, untrained_gru
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import (
    ACTION_SIZE,
    OBSERVATION_SIZE,
    PolicySpec,
    observe,
    remember,
)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Policy:
    """A multi-layer perceptron with ReLU between its layers, and all that is needed to fly it.

    Output: four actions, which `interface` clips to [-1, 1] and scales to commands.

    With a `gru` it remembers: the unit sees the first layer's values, and the second layer sees
    them and the memory. An observation then ends with the memory, and the output with the next.

    A network of another form (`policy_form`) sees and gives something else; the observations and
    actions are those of other policies.
    """

    weights: tuple[Float[Array, "outputs inputs"], ...]
    biases: tuple[Float[Array, "outputs"], ...]
    observation_mean: Float[Array, "20H+3K"]
    """Of what the network sees."""
    observation_std: Float[Array, "20H+3K"]
    interface: ControlInterface = dataclasses.field(
        default=interfaces.pwm(), metadata={"static": True}
    )
    """What the actions command, and how often."""
    gru: Gru | None = None
    """Behind the first layer, of M numbers; none: the policy remembers nothing but its history."""
    spec: PolicySpec = dataclasses.field(default=PolicySpec(), metadata={"static": True})
    """What it sees and remembers, and its hidden layers, which `check` compares with the arrays."""

    def __call__(self, observation: Float[Array, "20H+3K+M"]) -> Float[Array, "4+M"]:
        """Returns the action, not clipped, as the next observation holds it, and any memory."""
        form, size = self.spec.policy_form, self.spec.observed_size
        inputs, memory = observation[:size], observation[size:]
        values = (form.observed(inputs) - self.observation_mean) / self.observation_std
        hidden = zip(self.weights[:-1], self.biases[:-1], strict=True)
        for number, (weight, bias) in enumerate(hidden):
            values = jax.nn.relu(weight @ values + bias)
            if self.gru is not None and number == 0:
                memory = self.gru(values, memory)
                values = memory if form.through_memory else jnp.concatenate([values, memory])
        output = self.weights[-1] @ values + self.biases[-1]
        return jnp.concatenate([form.action_of(output), memory])

    def __repr__(self) -> str:
        """Returns its kind and sizes; its numbers would fill a screen."""
        memory = "" if self.gru is None else f", memory of {self.gru.size}"
        layers = "-".join(map(str, self.layer_sizes))
        return f"Policy({self.interface.name}, {self.interface.rate} Hz, layers {layers}{memory})"

    def plot(self) -> Any:
        """Returns a picture of the commands over the distance to the set-point at hover."""
        return PLOTS["policy"](self)

    @property
    def multiplications(self) -> int:
        """Of one action."""
        matrices = [] if self.gru is None else [self.gru.weights, self.gru.recurrent]
        return sum(matrix.size for matrix in (*self.weights, *matrices))

    @property
    def network(self) -> Any:
        """Weights, biases and recurrent unit or none, a tree of arrays: what a gradient changes."""
        return self.weights, self.biases, self.gru

    def with_network(self, network: Any) -> "Policy":
        """Returns the same policy with another network."""
        weights, biases, gru = network
        return dataclasses.replace(self, weights=weights, biases=biases, gru=gru)

    def must_be_plain(self) -> None:
        """Refuses a subclass, whose network files and other programs cannot hold.

        Raises:
            InputError: it is one.
        """
        if type(self) is not Policy:
            raise InputError(
                f"{type(self).__name__}: has a network of its own, which neither policy files nor "
                "exports hold. Fly it in Python, or train a Policy."
            )

    def check(self, source: str = "policy") -> None:
        """Checks that shapes and numbers make sense.

        Args:
            source: what errors name, such as the file.

        Raises:
            InputError: they do not.
        """
        _check_sizes(self, source)
        if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(self)):
            raise InputError(
                f"{source}: a weight is not a finite number. Train again or restore the file."
            )
        if not np.all(np.asarray(self.observation_std) > 0):
            raise InputError(f"{source}: an observation's standard deviation is not positive.")

    @property
    def layer_sizes(self) -> tuple[int, ...]:
        """Sizes of input, hidden layers and output, such as (40, 50, 50, 4)."""
        return (self.weights[0].shape[-1], *(weight.shape[-2] for weight in self.weights))


def untrained_policy(
    key: Array, interface: ControlInterface | None = None, spec: PolicySpec = PolicySpec()
) -> Policy:
    """Draws a policy with Kaiming-uniform weights and zero biases, or as its form says.

    Its last layer is small, so that it starts near a constant. Observations are scaled by fixed,
    round numbers of the circle task's size; training changes only the network.

    Args:
        key: random key.
        interface: what its actions command; PWM at 100 Hz by default.
        spec: what it sees and remembers, and its hidden layers.

    Raises:
        InputError: policies of the form command another interface.

    Source: Gronauer et al. 2022, sec. Zero-Shot Experiments (layer sizes and initial weights).
    """
    interface, form = interface or interfaces.pwm(), spec.policy_form
    form.check(interface, "policy")
    sizes, memory = spec.layer_sizes, spec.memory
    inputs_of = list(sizes[:-1])
    if memory:
        inputs_of[1] = memory if form.through_memory else inputs_of[1] + memory
    weights, keys = [], jax.random.split(key, len(sizes) - 1)
    for own_key, fan_in, outputs in zip(keys, inputs_of, sizes[1:], strict=True):
        bound = np.float32(np.sqrt(6.0 / fan_in) * (0.1 if outputs == ACTION_SIZE else 1.0))
        weights.append(jax.random.uniform(own_key, (outputs, fan_in), minval=-bound, maxval=bound))
    biases = tuple(
        jnp.full(outputs, 0.0 if number else form.first_bias, jnp.float32)
        for number, outputs in enumerate(sizes[1:])
    )
    gru = untrained_gru(jax.random.fold_in(key, 1), spec.hidden[0], memory) if memory else None
    mean, deviation = map(jnp.array, spec.scaling)
    return Policy(tuple(weights), biases, mean, deviation, interface, gru, spec)


class Act(NamedTuple):
    """What a policy does at one instant."""

    command: Float[np.ndarray, "4"]
    """In the units of the policy's interface."""
    action: Float[np.ndarray, "4"]
    """The network's output, not clipped."""


class Actor:
    """Flies a policy one instant at a time: it holds history, memory and last action.

    What it does is what the simulator does with the same policy. For drones and simulators that are
    not written in JAX; one flight at a time.
    """

    def __init__(self, policy: Policy, hover: float) -> None:
        """Begins a flight.

        Args:
            policy: what flies.
            hover: share of full thrust at which the drone hovers, 1 / thrust_to_weight; the last
                action before the first is the one that commands it.

        Raises:
            InputError: the policy makes no sense, or the share is not above 0 and at most 1.
        """
        policy.check()
        if not 0.0 < hover <= 1.0:
            raise InputError(f"hover = {hover}; expected a share above 0 and at most 1.")
        self.policy = policy
        self._level = np.asarray(policy.interface.level(jnp.float32(hover)))
        self.reset()

    def reset(self) -> None:
        """Begins another flight: forgets history, memory and last action."""
        self._history: Array | None = None
        self._memory: Any = np.zeros(self.policy.spec.memory, np.float32)
        self._action: Any = self._level

    def act(
        self, measurement: Measurement, setpoint: ArrayLike, ahead: ArrayLike | None = None
    ) -> Act:
        """Returns what to do now; to be called `policy.interface.rate` times a second.

        Args:
            measurement: what is known of the drone now.
            setpoint: where it shall be now [m], world, (3,).
            ahead: where it shall be at the K instants that the policy looks ahead at [m], world,
                (K, 3); required where it looks ahead, and only there.

        Raises:
            InputError: an argument, or an action, is not finite, or there are not K
                points ahead. What is remembered stays as it was.
        """
        points = np.zeros((0, 3), np.float32) if ahead is None else np.asarray(ahead, np.float32)
        wanted = self.policy.spec.look_ahead
        if points.shape != (wanted.points, 3):
            problem = "no points" if ahead is None else f"an array of shape {points.shape}"
            raise InputError(
                f"ahead: {problem}; the policy looks ahead at {wanted.points} points, "
                f"{wanted.spacing:g} s apart. Give where the drone shall be then, "
                f"({wanted.points}, 3) in m."
            )
        measured = Measurement(*(jnp.asarray(part, jnp.float32) for part in measurement))
        history = self._history
        if history is None:
            history = np.zeros((self.policy.spec.history, OBSERVATION_SIZE), np.float32)
        history, action, memory, command = _act(
            self.policy,
            history,
            self._history is None,
            measured,
            np.asarray(setpoint, np.float32),
            points,
            self._action,
            self._memory,
        )
        act = Act(np.asarray(command), np.asarray(action))
        is_finite = np.isfinite(history).all() and np.isfinite(points).all()
        if not (is_finite and np.isfinite(act.action).all()):
            raise InputError(
                f"measurement {measured}, setpoint {setpoint}, ahead {points.tolist()}: an action "
                f"of {act.action}. Expected finite numbers: let another controller fly."
            )
        self._history, self._action, self._memory = history, act.action, memory
        return act


@jax.jit
def _act(
    policy: Policy,
    history: Float[Array, "H 20"],
    first: Bool[Array, ""],
    measurement: Measurement,
    setpoint: Float[Array, "3"],
    ahead: Float[Array, "K 3"],
    last_action: Float[Array, "4"],
    memory: Float[Array, "M"],
) -> tuple[Float[Array, "H 20"], Float[Array, "4"], Float[Array, "M"], Float[Array, "4"]]:
    instant = observe(measurement, setpoint, last_action)
    filled = jnp.broadcast_to(instant, history.shape)
    history = jnp.where(first, filled, remember(history, instant))
    observation = policy.spec.observation(history, ahead, measurement.position, memory)
    action, memory = jnp.split(policy(observation), [ACTION_SIZE])
    return history, action, memory, policy.interface.command(action)


def _check_sizes(policy: Policy, source: str) -> None:
    spec = policy.spec
    if not policy.weights or len(policy.weights) != len(policy.biases):
        raise InputError(
            f"{source}: {len(policy.weights)} layers of weights and {len(policy.biases)} of biases"
            "; expected as many, and one or more."
        )
    form, size = spec.policy_form, spec.layer_sizes[0]
    if policy.observation_mean.shape != (size,) or policy.observation_std.shape != (size,):
        raise InputError(
            f"{source}: the normaliser has {policy.observation_mean.shape} values, expected {size} "
            f"({form.name if form.inputs else '20 x history, and 3 x points of the look-ahead'})."
        )
    for number, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True), 1):
        if weight.ndim != 2 or weight.shape[1] != size or bias.shape != weight.shape[:1]:
            raise InputError(
                f"{source}: layer {number} has weights {weight.shape} and biases {bias.shape}, "
                f"expected ({size} inputs)."
            )
        size = weight.shape[0]
        if number == 1 and policy.gru is not None:
            _check_gru(policy.gru, size, source)
            size = policy.gru.size if form.through_memory else size + policy.gru.size
    if size != ACTION_SIZE:
        raise InputError(f"{source}: {size} outputs, expected {ACTION_SIZE}.")
    memory = 0 if policy.gru is None else policy.gru.size
    if (policy.layer_sizes, memory) != (spec.layer_sizes, spec.memory):
        raise InputError(
            f"{source}: layers {policy.layer_sizes} and a memory of {memory}, but its spec says "
            f"{spec.layer_sizes} and {spec.memory}."
        )
    form.check(policy.interface, source)


def _check_gru(gru: Gru, inputs: int, source: str) -> None:
    shapes = gru.shapes_for(inputs) if np.ndim(gru.recurrent) == 2 else {}
    wrong = {name: pair for name, pair in shapes.items() if pair[0] != pair[1]}
    if wrong or not shapes:
        raise InputError(
            f"{source}: recurrent unit of {np.shape(gru.recurrent)} with shapes {wrong}, found and "
            "expected. Export or train the policy again."
        )
