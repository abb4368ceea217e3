"""Checks before a training that what is exported will fly the drone."""

from tempfile import TemporaryDirectory

import jax

from maidenflight.deployment import export
from maidenflight.deployment.frame import check_frame
from maidenflight.parameters import Parameters
from maidenflight.policy import untrained_policy
from maidenflight.simulator.controllers.interface import ControlInterface
from maidenflight.simulator.policy_spec import PolicySpec


def check_export(to: str, interface: ControlInterface, spec: PolicySpec, drone: Parameters) -> None:
    """Checks before a training that its policies can be exported: exports an untrained one.

    Raises:
        InputError: what is written could not hold them, or not fly the drone.
    """
    check_frame(to, interface, drone)
    with TemporaryDirectory() as folder:
        policy = untrained_policy(jax.random.key(0), interface, spec)
        export(policy, folder, to, name="policy", seed=0)
