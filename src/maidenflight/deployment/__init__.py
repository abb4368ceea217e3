"""Deployment: from a trained policy to what a drone runs.

`EXPORTERS` holds every form that a policy can be written in. Another one is a file with a function,
and a line here. Importing this package imports no JAX.
"""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight.errors import InputError

if TYPE_CHECKING:
    from maidenflight.inputs import StrPath
    from maidenflight.policy import Policy


@dataclass(frozen=True)
class Exporter:
    """A form that a policy can be written in."""

    function: str
    """`module:name` of a function of a policy, a folder and some of `takes`, which returns the
    files that it has written."""
    folder: str
    """Where to write unless given."""
    help: str
    """One sentence for the command line."""
    takes: tuple[str, ...] = ("record",)
    """Keywords that the function takes: `name` of the policy, `hover`, the share of full thrust at
    which its drone hovers, `seed` of random numbers in what is written, `record` of how the policy
    was made, `propellers` of the drone."""

    def __call__(self, policy: "Policy", folder: "StrPath", **given: Any) -> list[Path]:
        """Writes a policy.

        Args:
            policy: the policy.
            folder: where to write; made if missing.
            given: some of `name`, `hover`, `seed`, `record`, `propellers`; those that the function
                does not take are left out.

        Returns:
            The files written.

        Raises:
            InputError: what is written cannot hold the policy.
        """
        module, name = self.function.split(":")
        write = getattr(import_module(module), name)
        return write(policy, folder, **{key: given[key] for key in self.takes if key in given})


def export(policy: "Policy", folder: "StrPath", to: str = "c", **given: Any) -> list[Path]:
    """Writes a policy for other programs.

    Args:
        policy: the policy.
        folder: where to write; made if missing.
        to: a name in `EXPORTERS`.
        **given: see `Exporter.__call__`; what the exporter does not take is left out.

    Returns:
        The files written.

    Raises:
        InputError: no such exporter; or what is written cannot hold the policy.
    """
    if to not in EXPORTERS:
        raise InputError(f"to = {to!r}; expected one of {', '.join(EXPORTERS)}.")
    return EXPORTERS[to](policy, folder, **given)


_HERE = "maidenflight.deployment"
_RING = "maidenflight.integrations"
EXPORTERS: dict[str, Exporter] = {
    "c": Exporter(
        f"{_HERE}.c:export_c",
        "firmware",
        "C99 without dependencies, policy.h and policy.c",
        ("hover", "seed", "record"),
    ),
    "onnx": Exporter(
        f"{_RING}.exporters.onnx:export_onnx", "onnx_policy", "policy.onnx", ("hover", "record")
    ),
    "authors": Exporter(
        f"{_RING}.exporters.authors_json:export_authors_json",
        "authors_policy",
        "a JSON as the tools of Gronauer et al. read it",
        ("name",),
    ),
    "crazyflie": Exporter(
        f"{_RING}.exporters.crazyflie_app:export_crazyflie",
        "crazyflie_app",
        "an app that builds beside an unmodified Crazyflie firmware",
        ("hover", "seed", "record", "propellers"),
    ),
    "raptor": Exporter(
        f"{_RING}.raptor.checkpoint:export_raptor",
        "raptor_policy",
        "policy.h5, which programs for RAPTOR read, of a policy trained with --form raptor",
        ("name", "seed", "record"),
    ),
}
"""By the word that the command line takes."""
