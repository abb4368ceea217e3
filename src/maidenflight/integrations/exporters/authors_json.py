"""Writes the JSON policy files of Gronauer et al.; `policies.authors_policy` reads them."""

import json
from pathlib import Path

import numpy as np

from maidenflight import results
from maidenflight.deployment.commands import check_form
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.integrations.policies.authors_policy import (
    EPSILON,
    check_sum,
    control_of,
    interface_of,
)
from maidenflight.policy import Policy
from maidenflight.simulator.controllers.interface import CONTROLS, ControlInterface

MOST_LAYERS = 7
"""Layers that their firmware takes."""


def to_authors_json(policy: Policy) -> str:
    """Returns the text of one of the authors' policy files; `policy_file.from_json` reads it back.

    All numbers read back to the last bit, except standard deviations between 6.1e-5 and 1.2e-4,
    which may be one rounding of float32 off once `EPSILON` is added. The file does not hold the
    control structure: begin its name with that.

    Raises:
        InputError: the policy makes no sense, or is one that the authors' tools would take for
            another: by its interface, its form, its history or its deviations; or it has more
            layers than their firmware takes.
    """
    policy.check()
    check_form(policy)
    _check_interface(policy.interface)
    if beyond := policy.spec.beyond("hidden"):
        raise InputError(
            f"policy: {beyond}, but the authors' policies see 2 instants and no more. Train "
            "without, or export to c."
        )
    if len(policy.weights) > MOST_LAYERS:
        raise InputError(
            f"policy: {len(policy.weights)} layers, but the authors' firmware takes at most "
            f"{MOST_LAYERS}. Train fewer."
        )
    deviation = np.asarray(policy.observation_std)
    if np.any(deviation < np.float32(EPSILON)):
        raise InputError(
            f"policy: an observation's deviation is {deviation.min():.3g}, but the authors' files "
            f"hold none below {EPSILON:g}, which their tools add to it. Train with a larger one."
        )
    weights, biases = ([np.asarray(array) for array in arrays] for arrays in policy.network[:2])
    with np.errstate(over="ignore"):
        check = np.float32(check_sum(weights, biases)[0])
    if not np.isfinite(check):
        raise InputError("policy: its check sum overflows float32. Training diverged: train again.")
    scaling = [np.asarray(policy.observation_mean).tolist(), _before_adding(deviation).tolist()]
    layers = {
        str(number): {"type": "standard", "weights": weight.tolist(), "biases": bias.tolist()}
        for number, (weight, bias) in enumerate(zip(weights, biases, strict=True))
    }
    content = {"check_sum": str(check), "scaling_parameters": scaling, "activation": "relu"}
    return json.dumps(content | layers)


def _check_interface(interface: ControlInterface) -> None:
    """Their files hold a network alone; what its outputs command is fixed in their firmware."""
    if interface.name not in CONTROLS:
        raise InputError(
            f"policy: control = {interface.name!r}; the authors' drone knows {', '.join(CONTROLS)}."
        )
    theirs = interface_of(interface.name).to_dict()
    for name, value in interface.to_dict().items():
        if value != theirs[name]:
            raise InputError(
                f"policy: {name} = {value}, but the authors' drone runs {interface.name} policies "
                f"with {theirs[name]} and their files cannot say otherwise. Train with that."
            )


def export_authors_json(policy: Policy, directory: StrPath, *, name: str = "policy") -> list[Path]:
    """Writes one of the authors' policy files; see `to_authors_json`.

    Args:
        policy: the policy.
        directory: where to write; made if missing.
        name: of the file, without its ending. Unless it begins with the control structure, that is
            put before it, so that `policy_file.read_policy` knows what the policy commands.

    Returns:
        The file written, alone in a list.

    Raises:
        InputError: the authors' files cannot hold the policy, or the directory cannot be written.
    """
    text = to_authors_json(policy)
    if control_of(Path("/", f"{name}.json")) != policy.interface.name:
        name = f"{policy.interface.name}_{name}"
    return [results.write(Path(directory) / f"{name}.json", text)]


def _before_adding(deviation: np.ndarray) -> np.ndarray:
    """Numbers of float32 that, or nearly, are the deviations once `EPSILON` is added."""
    epsilon = np.float32(EPSILON)
    below = deviation - epsilon
    tried = np.stack(
        [below, np.nextafter(below, np.float32(0)), np.nextafter(below, np.float32(np.inf))]
    )
    best = np.argmin(np.abs((tried + epsilon).astype(np.float64) - deviation), axis=0)
    return np.take_along_axis(tried, best[None], axis=0)[0]
