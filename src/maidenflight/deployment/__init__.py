"""Deployment: from a trained policy to what a drone runs.

`registry.EXPORTERS` names every form that a policy can be written in. Importing this package
imports no JAX.
"""

from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight.inputs import PATHS
from maidenflight.registry import EXPORTERS

if TYPE_CHECKING:
    from maidenflight.inputs import StrPath
    from maidenflight.policy import Policy

_FOLDERS = {"c": "firmware", "crazyflie": "crazyflie_app"}


def choose_folder(to: str) -> str:
    """Returns where an exporter writes unless a folder is given."""
    return _FOLDERS.get(to, f"{to}_policy")


def keywords_of(to: str) -> set[str]:
    """Returns the keywords that an exporter takes; see `export`.

    Raises:
        InputError: no such exporter.
    """
    return set(signature(EXPORTERS[to]).parameters)


def export(
    policy: "Policy | StrPath", folder: "StrPath | None" = None, to: str = "c", **options: Any
) -> list[Path]:
    """Writes a policy for other programs.

    Args:
        policy: the policy or its file, which says what `name` and `hover` are.
        folder: where to write; made if missing. `choose_folder` by default.
        to: a name in `registry.EXPORTERS`.
        **options: some of `name` of the policy, `hover`, the share of full thrust at which its
            drone hovers, `seed` of random numbers in what is written, `record` of how the policy
            was made, and `propellers` of the drone; what the exporter does not take is left out.

    Returns:
        The files written.

    Raises:
        InputError: no such exporter; or what is written cannot hold the policy.
    """
    keywords = keywords_of(to)
    if isinstance(policy, PATHS):
        # Not above: importing this package imports no JAX.
        from maidenflight.deployment.frame import read_for

        file = read_for(policy, to)
        options = {"name": Path(policy).stem, "hover": file.hover, **options}
        policy = file.policy
    policy.must_be_plain()
    accepted = {name: value for name, value in options.items() if name in keywords}
    return EXPORTERS[to](policy, choose_folder(to) if folder is None else folder, **accepted)
