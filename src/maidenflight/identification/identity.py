"""Whose policy it is: what a policy file says of the drone that it was made for.

Compared before a flight, for a policy flies another drone badly without a word: its hover thrust
follows the mass, and its battery compensation the propellers.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from maidenflight import names
from maidenflight.errors import InputError
from maidenflight.identification.drone_file import DroneFile
from maidenflight.simulator.physics.battery import law_for

SAME_MASS = 0.05
"""Share by which two masses of one drone may differ: half of what policies are trained over by
Gronauer et al. 2022, sec. Domain Randomization; chosen, a scale's gram is 3 %."""
_PROPELLERS: dict[str, str] = dict(
    zip(
        (names.PLUS_PROPELLERS, names.LEGACY_PROPELLERS, names.THRUST_UPGRADE),
        names.PROPELLERS,
        strict=True,
    )
)


def identity_of(drone: DroneFile) -> dict[str, Any]:
    """Returns a drone's name, mass [kg] and, if known, battery law.

    The law is the one chosen in its identification, else that of the firmware of its logs.
    """
    settings = drone.record.get("settings", {})
    law = settings.get("battery_law") if isinstance(settings, dict) else None
    if law is None and drone.source is not None:
        law = law_for(drone.full_scale_counts).name
    known = {} if law is None else {"battery_law": law}
    mass = round(float(drone.parameters.mass), 6)
    return {"name": Path(drone.name).name.removesuffix(".toml"), "mass": mass, **known}


def propellers_of(identity: Mapping[str, Any]) -> str:
    """Returns propellers that a battery law stands for, of `names.PROPELLERS`; empty if unknown."""
    return _PROPELLERS.get(str(identity.get("battery_law")), "")


def describe_other_drone(own: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Returns how a policy's drone differs from another; empty where nothing says that it does.

    Args:
        own: the policy's identity.
        other: that of the drone that shall fly.
    """
    if "mass" in own and abs(other["mass"] / own["mass"] - 1.0) > SAME_MASS:
        return (
            f"made for a drone of {1e3 * own['mass']:,.1f} g, but {other['name']} has "
            f"{1e3 * other['mass']:,.1f} g"
        )
    laws = own.get("battery_law"), other.get("battery_law")
    if None not in laws and laws[0] != laws[1]:
        return (
            f"made with the battery law {laws[0]!r}, but {other['name']} was identified with "
            f"{laws[1]!r}"
        )
    return ""


def describe_other_counts(own: float, drone: DroneFile) -> str:
    """Returns how far simulated thrust is off where a policy's full command is not the drone's.

    Simulation takes a command of 1 as the drone's own; its firmware takes the counts. Empty where
    they are the same.

    Args:
        own: counts of PWM of the policy's full command.
        drone: that flies.
    """
    share = drone.full_scale_counts / own - 1.0
    if not share:
        return ""
    name = Path(drone.name).name.removesuffix(".toml")
    return (
        f"made for commands up to {own:,.0f} counts, but {name} for up to "
        f"{drone.full_scale_counts:,.0f}, so that thrust is simulated {abs(share):.0%} too "
        f"{'strong' if share > 0 else 'weak'}"
    )


def check_same_drone(source: str, own: Mapping[str, Any], other: Mapping[str, Any]) -> None:
    """Refuses a policy that was made for another drone.

    Args:
        source: the policy's file, for errors.
        own: the policy's identity.
        other: that of the drone that shall fly.

    Raises:
        InputError: mass or battery law differ, or the file says nothing of its drone.
    """
    if "mass" not in own:
        raise InputError(
            f"{source}: names no mass of its drone. Train again, or leave out --drone."
        )
    if difference := describe_other_drone(own, other):
        raise InputError(f"{source}: {difference}. Train for the drone that flies.")
