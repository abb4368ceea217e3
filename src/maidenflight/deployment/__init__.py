"""Deployment: from a trained policy to what a drone runs, and from a drone to other programs.

`registry.EXPORTERS` names every form that a policy can be written in, `registry.DRONE_FORMATS`
those of drones. Importing this package imports no JAX.
"""

from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maidenflight.registry import EXPORTERS

if TYPE_CHECKING:
    from maidenflight.inputs import StrPath
    from maidenflight.parameters import Parameters
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
    policy: "Policy | Parameters", folder: "StrPath", to: str = "c", **options: Any
) -> list[Path]:
    """Writes a policy, or a drone, for other programs.

    Args:
        policy: the policy; or a drone, which is written to one file.
        folder: where to write; made if missing. Of a drone the file.
        to: a name in `registry.EXPORTERS`; of a drone one in `registry.DRONE_FORMATS`.
        **options: some of `name` of the policy, `hover`, the share of full thrust at which its
            drone hovers, `seed` of random numbers in what is written, `record` of how the policy
            was made, and `propellers` of the drone; what the exporter does not take is left out.
            Of a drone `name`, `full_speed`, `samples` and `record`; see
            `drone_format.drone_text`.

    Returns:
        The files written.

    Raises:
        InputError: no such exporter or format; or what is written cannot hold the policy.
    """
    from maidenflight.parameters import Parameters

    if isinstance(policy, Parameters):
        from maidenflight import results
        from maidenflight.deployment.drone_format import drone_text

        options.setdefault("name", Path(folder).stem)
        return [results.write(folder, drone_text(policy, to, **options))]
    policy.must_be_plain()
    keywords = keywords_of(to)
    accepted = {name: value for name, value in options.items() if name in keywords}
    return EXPORTERS[to](policy, folder, **accepted)
