"""Settings that every training method has, how records say them, and those of PPO."""

from collections.abc import Mapping
from dataclasses import Field, asdict, dataclass, field, fields, replace
from typing import Any, ClassVar, Protocol, Self

import jax

from maidenflight.errors import InputError
from maidenflight.settings import plain

STATIC = {"static": True}
"""Marks a setting that is part of the compiled program: a size, or what decides which is built."""


class Settings(Protocol):
    """Settings that every method has; frozen dataclasses and pytrees."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def updates(self) -> int:
        """Gradient steps, or epochs."""
        ...

    @property
    def evaluations(self) -> int:
        """How often the policy is evaluated; the best one counts."""
        ...

    @property
    def episodes(self) -> int:
        """Episodes per evaluation."""
        ...

    @property
    def num_envs(self) -> int:
        """Environments simulated in parallel."""
        ...

    @property
    def horizon(self) -> int:
        """Control periods per environment and update."""
        ...


def check_counts(settings: Settings) -> None:
    """Refuses numbers of steps, environments and evaluations below 1.

    Raises:
        InputError: as above.
    """
    for name in ("updates", "evaluations", "episodes", "num_envs", "horizon"):
        value = getattr(settings, name)
        # Within a compiled program they are no numbers.
        if isinstance(value, int) and value < 1:
            raise InputError(f"{type(settings).__name__}: {name} = {value}; expected 1 or more.")


def recorded(settings: Settings) -> dict[str, Any]:
    """Returns settings as plain values, for records."""
    return plain(asdict(settings))


def override(settings: Settings, numbers: Mapping[str, float]) -> Settings:
    """Returns settings with other numbers, by the names of fields.

    Raises:
        InputError: there is no such number, or it is a whole one.
    """
    values = {field.name: getattr(settings, field.name) for field in fields(settings)}
    changes: dict[str, Any] = {}
    for name, value in numbers.items():
        if type(values.get(name)) not in (int, float):
            method = type(settings).__name__
            raise InputError(f"learner: {name} is no number of {method}: {', '.join(values)}.")
        whole = isinstance(values[name], int)
        if whole and value != int(value):
            raise InputError(f"learner: {name} = {value:g}; expected a whole number.")
        changes[name] = int(value) if whole else value
    return replace(settings, **changes)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PPO:
    """Settings of training by proximal policy optimisation.

    The defaults are ours, `paper` has the paper's. A pytree: sizes and numbers of passes are part
    of the compiled program, all else is traced.
    """

    updates: int = 600
    """Epochs: a rollout, followed by the optimiser's passes over it."""
    num_envs: int = field(default=512, metadata=STATIC)
    """Environments simulated in parallel, each with a drone of its own."""
    horizon: int = field(default=32, metadata=STATIC)
    """Control periods per environment and update; episodes continue in the next update."""
    critic_hidden: tuple[int, ...] = field(default=(64, 64), metadata=STATIC)
    """Sizes of the critic's hidden layers, tanh."""
    critic_sees_truth: bool = field(default=True, metadata=STATIC)
    """Whether the critic, which does not fly, also sees the true state and the drone's
    constants."""
    learning_rate: float = 2e-3
    """Adam's initial learning rate of the actor; it decays linearly to 0."""
    critic_learning_rate: float = 1e-3
    """Adam's learning rate of the critic."""
    actor_passes: int = field(default=4, metadata=STATIC)
    """The actor's passes over a rollout."""
    actor_minibatches: int = field(default=8, metadata=STATIC)
    """The actor's gradient steps per pass."""
    critic_passes: int = field(default=4, metadata=STATIC)
    """The critic's passes over a rollout."""
    critic_minibatches: int = field(default=8, metadata=STATIC)
    """The critic's gradient steps per pass."""
    clip: float = 0.2
    """Clip range of the probability ratio."""
    discount: float = 0.99
    """gamma, discount factor per control period [-]."""
    gae_lambda: float = 0.95
    """lambda of generalised advantage estimation [-]: 0 relies on the critic, 1 on rewards."""
    normalize_advantages: bool = field(default=True, metadata=STATIC)
    """Whether an update's advantages are normalised to mean 0 and standard deviation 1."""
    reward_clip: float = 3.0
    """Rewards, divided by the running standard deviation of discounted returns, are clipped to +-
    this value."""
    initial_noise_std: float = 0.4
    """Standard deviation of the noise on actions in the first update."""
    final_noise_std: float = 0.15
    """Standard deviation in the last update; it decays linearly."""
    evaluations: int = 15
    """How often the policy is evaluated; the best one counts."""
    episodes: int = 128
    """Episodes per evaluation."""

    def __post_init__(self) -> None:
        check_counts(self)

    @classmethod
    def paper(cls) -> Self:
        """Returns the paper's settings: 500 epochs of 64,000 steps, as by 64 workers of 1,000.

        What differs: episodes continue from one epoch to the next, while the paper's workers were
        reset; minibatches are drawn from all environments together; the actor's last layer starts
        ten times smaller, and the first epoch normalises as `policy.untrained_policy` does.

        Source: Gronauer et al. 2022, sec. Zero-Shot Experiments; reward scaling and the critic's
        passes are from the authors' code.
        """
        return cls(
            updates=500,
            num_envs=64,
            horizon=1000,
            critic_sees_truth=False,
            learning_rate=3e-4,
            critic_learning_rate=1e-3,
            actor_passes=80,
            actor_minibatches=1,
            critic_passes=5,
            critic_minibatches=16,
            normalize_advantages=False,
            reward_clip=10.0,
            initial_noise_std=0.5,
            final_noise_std=0.01,
        )
