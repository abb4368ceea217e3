"""`Fly`: flights of a real Crazyflie."""

import select
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from maidenflight import names
from maidenflight.errors import InputError
from maidenflight.integrations.radio.blocks import LIMITS
from maidenflight.settings import choice, flag, number, path, setting, text, whole
from maidenflight.verb import Output, Progress, Result, Verb
from maidenflight.verbs import shared

if TYPE_CHECKING:
    from maidenflight.integrations.radio.preflight import Expected

COUNTDOWN_S = 3
"""Seconds between Enter and the take-off."""


class Fly(Verb):
    """Fly a real Crazyflie, and log its flights.

    The policy on board flies, as an exported app, or the firmware's PID, or a --plan. Read
    docs/real-drones.md first. The firmware's PID takes off before it and lands after it; the log
    comes by radio at 100 Hz. Ctrl-C hands back to the PID and lands, a second Ctrl-C stops the
    motors. Every row is on disk as soon as it has come; logs are added to the folder and never
    replaced.
    """

    output = Output("flown", "Folder for the logs.")
    replaces, in_studies = False, False

    uri: str | None = setting(
        text("an address", "URI"),
        None,
        f"Address of the Crazyflie, such as {shared.URI}.",
        shared.FLIGHTS,
    )
    pilot: str = setting(
        choice("policy", "pid"),
        "policy",
        "What flies: the policy on board, or the firmware's PID, whose logs are for identify.",
    )
    flights: int | None = setting(
        whole(1, 999), None, "How many flights; 1 by default, 4 by the PID."
    )
    duration: float | None = setting(
        number(1.0, 600.0),
        None,
        "Seconds of each; 10 by default, 30 by the PID.",
    )
    task: str = setting(choice(*names.REAL_TASKS), "circle", "Task to fly.")
    height: float = setting(
        number(0.3, 1.6),
        1.0,
        "Metres above the ground; a policy was trained for 1.",
    )
    steps: float | None = setting(
        number(0.0, 0.2),
        None,
        "Random steps of the PID's set-point, in metres, twice a second, which make lag and "
        "latency visible; 0.1 by default, 0: the plain reference.",
    )
    plan: Path | None = setting(
        path("a plan", "FILE"), None, "Fly this plan of maidenflight plan by the PID.", files=True
    )
    full_scale_counts: float | None = setting(
        number(30000.0, 65535.0),
        None,
        "Firmware counts of a thrust command of 1, if not those of the exported policy.",
        rare=True,
    )
    policy: Path | None = setting(
        path("a policy file", "POLICY"),
        None,
        "Policy that must be on board, refused otherwise, and recorded.",
        files=True,
        producer="train",
    )
    drone: str | None = shared.drone(
        None, "Drone that flies: refused where the policy was made for another one."
    )
    tilt: float | None = setting(
        number(5.0, LIMITS["mf.tilt"]),
        None,
        "The policy's largest tilt [deg].",
        rare=True,
        consent=True,
    )
    rate: float | None = setting(
        number(50.0, LIMITS["mf.rate"]),
        None,
        "The policy's largest roll and pitch rate [deg/s].",
        rare=True,
        consent=True,
    )
    distance: float | None = setting(
        number(0.05, LIMITS["mf.distance"]),
        None,
        "The policy's largest distance from the set-point [m].",
        rare=True,
        consent=True,
    )
    yes: bool = setting(
        flag(),
        False,
        "Take off without asking for Enter, as for scripts.",
        recorded=False,
        consent=True,
    )
    no_propeller_test: bool = setting(
        flag(), False, "Leave out the firmware's test of propellers.", rare=True, consent=True
    )
    recover: bool = setting(
        flag(),
        False,
        "Fly nothing; make the logs that a crash has left as rows in the folder.",
        recorded=False,
    )
    seed: int = shared.seed()

    def places(self, output: Path) -> list[Path]:
        """Returns nothing: logs are added to what is there."""
        return []

    def check_early(self) -> None:
        """Refuses settings that mean nothing for what flies."""
        by_plan = ("pilot", "duration", "task", "height", "steps", "full_scale_counts", "recover")
        shared.must_be_default(self, by_plan if self.plan else (), "the plan defines the flight")
        own = ("policy", "drone", "tilt", "rate", "distance")
        by_policy = ("steps",) if self.pilot == "policy" else ("full_scale_counts", *own)
        shared.must_be_default(self, by_policy, f"it means nothing for --pilot {self.pilot}")
        if self.drone is not None and self.policy is None:
            raise InputError("--policy is missing; expected the file whose drone is compared.")
        if self.uri is None and not self.recover:
            raise InputError(
                f"--uri is missing; expected the address of a Crazyflie, such as {shared.URI}."
            )

    def _expected(self) -> tuple["Expected", dict[str, object]]:
        """What must be on board, and what records say of the policy."""
        from maidenflight import policy_file
        from maidenflight.deployment.c import digest
        from maidenflight.identification import drone_file, identity
        from maidenflight.integrations.radio.preflight import Expected

        if self.policy is None:
            return Expected(), {}
        file = policy_file.read_policy(self.policy)
        code, own = digest(file.policy), file.identity
        if self.drone is not None:
            flies = identity.identity_of(drone_file.read(self.drone))
            identity.check_same_drone(str(self.policy), own, flies)
        recorded = {"file": self.policy.name, "sha256": code, "drone": own}
        return Expected(code=code[:8], propellers=identity.propellers_of(own)), recorded

    def compute(self, output: Path, progress: Progress) -> Result:
        """Flies; writes a log a flight. Says on standard error what the drone does."""
        from maidenflight.flights import flight_plan
        from maidenflight.flights.flight_plan import FlightPlan

        if self.recover:
            return _recover(output)
        from maidenflight.integrations.radio.flight import COMPLETE
        from maidenflight.integrations.radio.session import Care, Course, record

        pid, real = self.pilot == "pid", (self.uri or "").startswith(("radio://", "usb://"))
        course: FlightPlan | Course = Course(
            self.task,
            self.duration or (30.0 if pid else 10.0),
            self.height,
            (0.1 if self.steps is None else self.steps) if pid else 0.0,
            policy=not pid,
            full_scale_counts=self.full_scale_counts,
            on_board={
                f"mf.{name}": value
                for name in ("tilt", "rate", "distance")
                if (value := getattr(self, name)) is not None
            },
        )
        expected, policy = self._expected()
        care = Care(
            expected,
            test_propellers=not self.no_propeller_test,
            confirmed=_countdown if self.yes else _enter,
            settings={"policy": policy} if policy else {},
        )
        if self.plan is not None:
            course = flight_plan.read(self.plan)
        count = self.flights or (4 if pid and self.plan is None else 1)
        uri = self.uri or ""
        session_result = record(uri, output, course, count, self.seed, say=_say, care=care)
        complete = [flight.ending.reason for flight in session_result] == [COMPLETE] * count
        flown = [
            {"flight": flight.name, "ended": flight.ending.reason, "packets": flight.rows}
            | {"log": str(flight.log) if flight.log else None}
            for flight in session_result
        ]
        return Result(
            content={"flights": flown, "simulated": not real},
            summary=[f"{len(session_result)} flights in {output}/"],
            notes=[note for flight in session_result for note in flight.notes],
            next=("identify", output),
            exit_code=0 if complete else 1,
            value=session_result,
        )


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _enter(stops: Callable[[], int]) -> bool:
    """Waits for Enter, or a request to stop, then counts down."""
    if not sys.stdin.isatty():
        raise InputError(
            "nobody can confirm the take-off: the input is no terminal. Give --yes to take off "
            "without."
        )
    _say(f"Enter takes off in {COUNTDOWN_S} s; Ctrl-C ends")
    while not select.select([sys.stdin], [], [], 0.1)[0]:
        if stops():
            return False
    return bool(sys.stdin.readline()) and _countdown(stops)


def _countdown(stops: Callable[[], int]) -> bool:
    """Counts down to the take-off; whether nobody asked to stop."""
    for left in range(COUNTDOWN_S, 0, -1):
        _say(f"take-off in {left} s")
        time.sleep(1.0)
        if stops():
            return False
    return True


def _recover(folder: Path) -> Result:
    """Makes logs of the rows that a crash has left."""
    from maidenflight.integrations.radio.row_files import recover

    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder. Give the one that was recorded into, with -o.")
    recovered, refused = recover(folder)
    return Result(
        content={"logs": [str(path) for path in recovered], "refused": refused},
        summary=[f"{len(recovered)} logs made of rows in {folder}/"],
        notes=refused,
        next=("identify", folder) if recovered else (),
    )
