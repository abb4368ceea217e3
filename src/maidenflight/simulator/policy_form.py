"""`PolicyForm`: what a network of another shape than ours sees and commands, in terms of ours.

Whatever flies policies gives one of any form an observation of ours, and takes an action of ours.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Array, ArrayLike, Float

from maidenflight.errors import InputError
from maidenflight.registry import POLICY_FORMS
from maidenflight.simulator.controllers.interface import ControlInterface, pwm


def _same(values: Any) -> Any:
    return values


@dataclass(frozen=True, eq=False)
class PolicyForm:
    """A form of policies; as it stands, that of ours."""

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
    check: Callable[[ControlInterface, str], None] = lambda commanded, place: None
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


def require_pwm(form: str, commanded: ControlInterface, place: str = "policy") -> None:
    """Checks that an interface is the motors', as policies of a form command it.

    Args:
        form: its name.
        commanded: what they command.
        place: what errors name, such as the file.

    Raises:
        InputError: it is another.
    """
    usual = pwm(full_scale_counts=commanded.full_scale_counts)
    if commanded != usual:
        raise InputError(
            f"{place}: {commanded.name} at {commanded.rate} Hz; a policy of the form {form} has "
            f"pwm at {usual.rate} Hz."
        )


INSTANTS = PolicyForm("instants")
"""Of a policy whose network sees observations as they are, and gives actions."""


def form_of(name: str) -> PolicyForm:
    """Returns a form by name, `instants` or one of `registry.POLICY_FORMS`.

    Raises:
        InputError: there is no such form.
    """
    if name == INSTANTS.name:
        return INSTANTS
    if not isinstance(name, str) or name not in POLICY_FORMS:
        forms = ", ".join([INSTANTS.name, *POLICY_FORMS])
        raise InputError(f"form = {name!r}, expected one of {forms}.")
    return POLICY_FORMS[name]
