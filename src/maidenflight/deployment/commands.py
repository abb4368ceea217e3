"""What a policy commands, in words for people and as C, from its control interface."""

import numpy as np

from maidenflight.errors import InputError
from maidenflight.policy import Policy
from maidenflight.simulator.controllers.interface import THRUST, ControlInterface
from maidenflight.simulator.policy_spec import INSTANTS

_FOLLOWED = (
    "The firmware's PIDs follow them. Its commander takes degrees, and its pitch has the other "
    "sign: give it -command[2] 180 / pi."
)
_NOTES = {
    "pwm": "Motors: 0 front right, 1 back right, 2 back left, 3 front left (the firmware's M1 to "
    "M4); the first and the third turn counter-clockwise from above.",
    "attitude_rate": "Command 0 is collective thrust; 1 to 3 are roll, pitch and yaw rate, body. "
    + _FOLLOWED,
    "attitude": f"Command 0 is collective thrust; 1 to 3 are roll, pitch and yaw. {_FOLLOWED}",
}
"""What units leave open, by the name of the interface."""


def described(interface: ControlInterface) -> str:
    """Returns what the four commands are, in one paragraph."""
    commands = zip(interface.centre, interface.span, interface.units, strict=True)
    ranges = [
        f"[{index}] {np.float32(centre - span):.6g} to {np.float32(centre + span):.6g} {unit}"
        for index, (centre, span, unit) in enumerate(commands)
    ]
    parts = [f"command = centre + span clip(action, -1, 1), in {'; '.join(ranges)}."]
    if THRUST in interface.units:
        parts.append(
            f"A share of 1 is {interface.full_scale_counts:g} of the firmware's 65535 counts "
            "before battery compensation."
        )
    parts.append(_NOTES.get(interface.name, ""))
    return " ".join(part for part in parts if part)


def check_hover(share: float | None) -> None:
    """Checks the share of full thrust at which a drone hovers; None where it is not known.

    Raises:
        InputError: it is no share.
    """
    if share is not None and not 0.0 < share <= 1.0:
        raise InputError(f"hover = {share}; expected a share above 0 and at most 1.")


def check_form(policy: Policy) -> None:
    """Checks that a network sees observations as they are, and gives actions.

    Raises:
        InputError: it does not.
    """
    form = policy.spec.form
    if form != INSTANTS:
        raise InputError(
            f"policy: of the form {form}, which is exported --to {form} only. Train without "
            "--form to export to another target."
        )


def level_in_c(interface: ControlInterface) -> str:
    """Returns the action that keeps a drone level, in C; `share` of full thrust hovers."""
    terms = []
    for slope, offset in zip(*interface.level_line, strict=True):
        constant = f"{np.float32(abs(offset))!s}f"
        sign = "-" if offset < 0.0 else ""
        between = "-" if offset < 0.0 else "+"
        terms.append(
            f"{np.float32(slope)!s}f * share {between} {constant}" if slope else sign + constant
        )
    return "{" + ", ".join(terms) + "}"
