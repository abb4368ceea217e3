"""Settings that several verbs have, and what the command line says of them."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from maidenflight import names
from maidenflight.errors import InputError
from maidenflight.settings import (
    PENDING,
    choice,
    either,
    flag,
    listed,
    number,
    or_code,
    path,
    setting,
    several,
    text,
    whole,
)
from maidenflight.verb import Verb

URI = "radio://0/80/2M/E7E7E7E7E7"
"""Address of a Crazyflie, for example."""
REALITIES = (
    "near:SEED, virtual:SEED or far:SEED, with growing mismatch to the training model; "
    "near:SEED@DRONE and so on, about a drone of your own; "
    "pybullet:SEED (virtual:SEED in PyBullet); mujoco:DRONE; "
    "l2f:DRONE or crazyflow:DRONE, drones of those simulators; "
    "MODULE:FACTORY of your own; or a drone's TOML file; +sensors, +10ms, +yaw6000, +weak10 and "
    "+payload15 behind any of them"
)
PARAMETERS = listed(text(metavar="NAME"), "names of parameters, such as latency,inertia_x", "NAMES")
DRONES = "Drone"
"""Heading of settings that say which drone it is."""
FLIGHTS = "Flights"
"""Heading of settings of flights."""
LOGS = "Logs"
"""Heading of settings that say how logs are read."""
LARGEST = {
    "tilt (limit 30)": "{largest_tilt:.0f deg}",
    "rate (limit 800)": "{largest_body_rate:.0f deg/s}",
    "farthest": "{largest_distance:.0f cm}",
}
"""Columns of the largest tilt, body rate and distance of flights, beside the limits of guards."""
ERRORS = {"error": "{position_error:.1f cm}", "estimated": "{estimated_error:.1f cm}"}
"""Columns of mean distances from the set-point, true and as the drone estimates them."""
CHANGE = "change of u\nin 10 ms"
"""Column of the mean change of commands."""
RARE = (CHANGE, *reversed(LARGEST), "estimated")
"""Columns of flights that a narrow terminal leaves out first."""


def _names_reality_in_code(text: str) -> bool:
    if ":" not in text:
        return False
    from maidenflight.simulator.realities.reality import imports_code

    return imports_code(text)


def _names_policy_in_code(text: str) -> bool:
    from maidenflight.flying.foreign_policy import imports_code

    return imports_code(text)


REALITY = dataclasses.replace(text("a reality", "REALITY"), names_code=_names_reality_in_code)
"""Names of realities, and MODULE:FACTORY of one's own."""
POLICY = dataclasses.replace(
    text("a policy file or a folder of them"), names_code=_names_policy_in_code
)
"""Policies, and MODULE:NAME of one's own."""
DRONE = dataclasses.replace(REALITY, expected="a drone's name or TOML file", metavar="DRONE")


def seed(default: int = 0) -> Any:
    """Declares the random seed."""
    return setting(
        whole(0, 2**31 - 1),
        default,
        "Random seed; equal seeds give equal results.",
        group="Output",
    )


def logs() -> Any:
    """Declares the logs that a verb reads."""
    return setting(path("a flight log or a folder of them"), argument=True, files=True)


def policies() -> Any:
    """Declares the policies that a verb flies."""
    return setting(
        several(POLICY),
        argument=True,
        files=True,
        producer="train",
    )


def drone(default: Any, help: str = "", **more: Any) -> Any:
    """Declares the drone of a verb."""
    return setting(DRONE, default, help, group=DRONES, files=True, producer="identify", **more)


def realities(default: Any, help: str) -> Any:
    """Declares where policies fly."""
    return setting(several(REALITY), default, help, group=FLIGHTS, files=True)


def accept_bounds() -> Any:
    """Declares whether drones at a search bound are taken."""
    return setting(
        flag(),
        False,
        "Take a drone although an identified parameter lies at a bound of its search, where its "
        "interval is too narrow.",
        group=DRONES,
        rare=True,
        consent=True,
    )


def mass() -> Any:
    """Declares the mass of what flies."""
    return setting(
        number(5.0, 5000.0, "g"),
        None,
        "Mass of what flies [g], battery and decks included; that of the drone by default. "
        "Inertia and thrust-to-weight ratio follow it.",
        group=DRONES,
    )


def most_seconds() -> Any:
    """Declares how much flight of the logs is used."""
    return setting(
        number(10.0, 1e6),
        3600.0,
        "Flight to use [s]; of more, segments of every flight are.",
        group=LOGS,
    )


def commands() -> Any:
    """Declares what logged commands stand for."""
    return setting(
        choice(*names.COMMANDS),
        None,
        "What commands stand for in logs that do not say it: each acts until the next row, as a "
        "policy's or a card's at 500 Hz, or the log is subsampled from the firmware's faster PID. "
        "maidenflight log shows what is assumed. Taken the wrong way, latency is half a row off.",
        group=LOGS,
        rare=True,
    )


def ignore() -> Any:
    """Declares which signals of logs are passed over."""
    return setting(
        several(choice(*names.OPTIONAL_SIGNALS), empty=True),
        (),
        "Signal to pass over as if it had not been logged, to judge the estimates without it; may "
        "be repeated.",
        group=LOGS,
        rare=True,
    )


def battery_law() -> Any:
    """Declares the law by which logged PWM is read as thrust."""
    laws = ", ".join(repr(law) for law in names.BATTERY_LAWS)
    return setting(
        text("a battery law", "NAME"),
        None,
        f"Battery compensation by which logged PWM is read as thrust: {laws}. The logs decide "
        "by default.",
        group=LOGS,
        rare=True,
    )


def faulty() -> Any:
    """Declares what is done with logs that contradict physics."""
    return setting(
        choice(*names.FAULTY_LOGS),
        names.FAULTY_LOGS[0],
        "Logs whose conventions contradict physics, such as the order of the motors: refuse them "
        "and with them the folder, of which the others are most likely wrong too; skip them; or "
        "use them all the same. maidenflight log shows the check-up.",
        group=LOGS,
        rare=True,
    )


def rate() -> Any:
    """Declares the rate of a simulated log."""
    return setting(
        whole(1, 500),
        500,
        "Rows a second of the log [Hz], a divisor of 500: 500 as on a micro-SD card, 100 as by "
        "radio, which holds one command in five.",
    )


def firmware(help: str) -> Any:
    """Declares the generation of the firmware."""
    return setting(choice(*names.FIRMWARES), names.FIRMWARES[0], help, rare=True)


def conditions() -> Any:
    """Declares the conditions of flights."""
    return setting(
        path("a TOML file", "FILE"),
        None,
        "Firmware, first states and guard of the drone: today's firmware, hover and the guard of "
        "the app by default; paper/settings/gronauer_2021.toml of the repository has the paper's.",
        files=True,
        rare=True,
    )


def control_of_authors() -> Any:
    """Declares what the authors' policies command."""
    return setting(
        or_code(choice(*names.CONTROLS)),
        None,
        "What the authors' policies command; by default, what their files' names begin with or "
        "their folder is called. Ours say it, and need it where it is MODULE:NAME of your own.",
        rare=True,
    )


def width_or(*words: str) -> Any:
    """Takes a half width of a box, or a word."""
    return either(number(0.0, 0.9), *words)


def own_files(*values: Any) -> list[str]:
    """Returns those of some paths and names that are files, for records."""
    return [str(value) for value in values if value is not None and Path(value).is_file()]


def must_exist(drone: Any) -> None:
    """Refuses a drone's TOML file that is not there, before anything heavy is imported.

    Raises:
        InputError: there is no such file.
    """
    if drone not in (None, PENDING) and drone.endswith(".toml") and not Path(drone).exists():
        raise InputError(
            f"{drone}: no such drone. Identify one (maidenflight identify LOGS -o {drone}), or "
            "give another file or a name (maidenflight drone --list)."
        )


def must_be_default(verb: Verb, settled: Sequence[str], reason: str) -> None:
    """Refuses settings that something else settles.

    Raises:
        InputError: one of them is not as by default.
    """
    for name, (attribute, declared) in verb.settings().items():
        if attribute in settled and getattr(verb, attribute) != declared.default:
            raise InputError(f"--{name.replace('_', '-')}: {reason}. Leave it out.")
