"""A session with a real Crazyflie: checks, flights one after the other, a folder of logs."""

import dataclasses
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from maidenflight import cache, manifest, results, run_folder
from maidenflight.errors import InputError
from maidenflight.flights.flight_plan import FlightPlan
from maidenflight.integrations.radio import row_files
from maidenflight.integrations.radio.blocks import LIMITS, LONGEST, PERIOD
from maidenflight.integrations.radio.clock import Clock, WallClock
from maidenflight.integrations.radio.crazyflie import Crazyflie
from maidenflight.integrations.radio.flight import COMPLETE, Ending, Plan, fly
from maidenflight.integrations.radio.preflight import Expected, examine
from maidenflight.integrations.radio.watch import Limits
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.trajectories import Trajectory

MARGIN = 2.0
"""Time that the policy's time limit leaves after a flight [s]."""
LASTING = 0.5
"""Time that a step of the set-point lasts [s]."""
PAUSE = 3.0
"""Between two flights [s]."""


@dataclass(frozen=True)
class Course:
    """A task of a real flight."""

    task: str = "circle"
    """Task of the reference, a name of `tasks.TASKS`."""
    duration: float = 30.0
    """Of the reference [s]."""
    height: float = 1.0
    """Of its start [m]."""
    steps: float = 0.1
    """See `reference`; each flight has its own [m]."""
    policy: bool = False
    """Whether the policy on board flies."""
    full_scale_counts: float | None = None
    """In place of the policy's own counts of a thrust command of 1; see `Plan`."""
    on_board: Mapping[str, float] = field(default_factory=dict)
    """Limits of the policy on board that are tighter than `LIMITS`, by parameter."""

    @property
    def limits_on_board(self) -> dict[str, float]:
        """Returns all limits of the policy on board.

        Raises:
            InputError: one is looser than the app's own.
        """
        bounds = {LONGEST: self.duration + MARGIN, **self.on_board}
        looser = [name for name, value in bounds.items() if not 0.0 < value <= LIMITS[name]]
        if looser and self.policy:
            raise InputError(
                f"{looser[0]} = {bounds[looser[0]]:g}; expected more than 0 and at most "
                f"{LIMITS[looser[0]]:g}, the limit of the app on board."
            )
        return {**LIMITS, **bounds}

    def plan(self, seed: int) -> Plan:
        """Plans a flight, with random steps of a seed."""
        trajectory = tasks.TASKS[self.task]().reference
        places = reference(trajectory, self.duration, self.height, self.steps, seed)
        on_board = self.limits_on_board if self.policy else {}
        return Plan(places, self.policy, self.full_scale_counts, on_board=on_board)

    @property
    def settings(self) -> dict[str, object]:
        """Returns what it is, for records."""
        own = dataclasses.asdict(self)
        own.pop("on_board")
        if self.policy:
            own["limits_on_board"] = self.limits_on_board
        if not self.policy or self.full_scale_counts is None:
            del own["full_scale_counts"]
        return own


class Care(NamedTuple):
    """What is expected before the first take-off of a session."""

    expected: Expected = Expected()
    """Of the app on board, where a policy flies; its limits are those of the course."""
    limits: Limits = Limits()
    """Where to break off."""
    test_propellers: bool = False
    """Whether each motor is spun a moment by the firmware."""
    confirmed: Callable[[Callable[[], int]], bool] = lambda stops: True
    """Asks whether to take off; given the number of requests to stop."""
    settings: Mapping[str, object] = MappingProxyType({})
    """For records, such as the policy's file."""


class FlightResult(NamedTuple):
    """A flight and what is left of it."""

    name: str
    ending: Ending
    rows: int
    """Packets received and written."""
    log: Path | None
    """For `identify`; nothing where the rows hold no flight."""
    notes: tuple[str, ...]


def reference(
    trajectory: Trajectory, duration: float, height: float, steps: float, seed: int
) -> Float[np.ndarray, "N 3"]:
    """Returns set-points each 10 ms.

    A trajectory that begins above the take-off, plus random steps.

    On a slow circle a PID reacts to disturbances that are not logged; steps from outside the loop
    make lag and thrust identifiable. Each axis steps by itself, up or down, twice
    a second; height by half.

    Args:
        trajectory: set-point [m] at a time [s].
        duration: [s].
        height: of its start [m].
        steps: their size [m]; 0: none.
        seed: of the steps.
    """
    times = jnp.asarray(np.arange(round(duration / PERIOD), dtype=np.float32) * np.float32(PERIOD))
    places = np.asarray(jax.vmap(trajectory)(times), np.float64)
    places = places - places[0] + [0.0, 0.0, height]
    number = (np.arange(len(places)) * PERIOD / LASTING).astype(int)
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (number[-1] + 1, 3))
    # It begins and ends without a step, so that the drone is handed over at rest.
    signs[[0, -1]] = 0.0
    return places + steps * signs[number] * [1.0, 1.0, 0.5]


def of_flight_plan(plan: FlightPlan) -> Plan:
    """Returns a flight plan's commands for a real drone: positions and yaw.

    Raises:
        InputError: it excites the motors, which no set-point can ask for.
    """
    excited = [block.manoeuvre.name for block in plan.blocks if not block.manoeuvre.by_setpoints]
    if excited:
        raise InputError(
            f"{plan.name}: {', '.join(excited)} is thrust on single motors, which the radio link "
            "cannot ask a real drone for. Plan without --motors."
        )
    places = plan.setpoints()
    return Plan(places[:, :3], yaw=places[:, 3])


def within(room: tuple[float, float, float], limits: Limits) -> Limits:
    """Returns the limits, narrowed to a room."""
    fence, ceiling = min(limits.fence, room[0] / 2, room[1] / 2), min(limits.ceiling, room[2])
    return replace(limits, fence=fence, ceiling=ceiling)


def checked_plan(plan: Plan, limits: Limits) -> Plan:
    """Returns the plan, if it stays within the limits.

    Raises:
        InputError: it does not.
    """
    low, high = plan.reference.min(axis=0), plan.reference.max(axis=0)
    reach = float(np.abs([low[:2], high[:2]]).max())
    if low[2] < 0.3 or high[2] > limits.ceiling - 0.2 or reach > limits.fence - 0.2:
        raise InputError(
            f"the reference goes from {low[2]:.2f} to {high[2]:.2f} m in height and {reach:.2f} m "
            f"far from the take-off; expected 0.3 to {limits.ceiling - 0.2:.1f} m, and at most "
            f"{limits.fence - 0.2:.1f} m. Choose another height or smaller steps."
        )
    return plan


@contextmanager
def stop_requests() -> Iterator[Callable[[], int]]:
    """Counts Ctrl-C, hang-ups and requests to terminate: the drone must land first.

    Yields:
        number of requests to stop.
    """
    count_so_far = 0

    def count(*_: object) -> None:
        nonlocal count_so_far
        count_so_far += 1

    names = "SIGINT", "SIGTERM", "SIGHUP"
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {number: signal.signal(number, count) for number in numbers}
    try:
        yield lambda: count_so_far
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def flights(
    drone: Crazyflie,
    plans: list[Plan],
    folder: Path,
    record: Mapping[str, Any],
    *,
    clock: Clock,
    stops: Callable[[], int],
    say: Callable[[str], None],
    care: Care = Care(),  # noqa: B008
) -> list[FlightResult]:
    """Flies plans one after the other, as long as each one ends as it should.

    Writes a file of rows and a log for each.

    Args:
        drone: connected.
        plans: what to fly; see `checked_plan`.
        folder: where to write. Names go on where those in the folder end; nothing is overwritten.
        record: how they are made, as `results.record` gives it; each flight adds its own.
        clock: the program's.
        stops: number of requests to stop.
        say: called with messages.
        care: what is expected before the first take-off.

    Raises:
        InputError: the drone is not fit for the first flight, or rows can no longer be written; the
            drone has landed then.
        WriteError: the file of rows cannot be made.
    """
    limits = care.limits
    results_so_far: list[FlightResult] = []
    for number, plan in enumerate(plans):
        expected = None
        if plan.policy:
            expected = care.expected._replace(limits=plan.on_board or LIMITS)
        tests = care.test_propellers and not results_so_far
        table = examine(drone, limits, clock, stops, expected, tests)
        against = [finding.problem for finding in table if finding.problem]
        if stops():
            say("no further flight: stopped by hand")
            break
        if not results_so_far:
            for finding in table:
                say(str(finding))
        if against and not results_so_far:
            raise InputError(f"{drone.uri}: not taking off: {'; '.join(against)}.")
        if against:
            say(f"no further flight: {'; '.join(against)}")
            break
        if not results_so_far and not care.confirmed(stops):
            say("no flight: not confirmed")
            break
        name = _next_name(folder)
        own = {"flight": number + 1, "deck": ", ".join(drone.decks)}
        own |= {what: value for what, value in drone.identity.items() if value}
        flight_record = {**record, "settings": {**record["settings"], **own}}
        path = folder / f"{name}{row_files.SUFFIX}"
        file = row_files.RowFile(path, drone.blocks, drone.simulated, flight_record)
        say(f"{name}: battery {drone.latest.battery if drone.latest else float('nan'):.2f} V")
        drone.write_to(file)
        try:
            ending = fly(drone, plan, limits, clock, file, stops, say)
        finally:
            drone.write_to(None)
            file.close()
        results_so_far.append(_filed(folder, name, ending, file.rows))
        manifest.append(folder, "fly", {"logs": run_folder.LOG.find(folder)}, flight_record)
        say(f"{name}: {ending.reason}, {file.rows} packets")
        if file.error is not None:
            raise InputError(
                f"{file.path}: rows could no longer be written ({file.error.strerror}); landed. "
                "Free space there."
            )
        if ending.reason != COMPLETE:
            break
        if number + 1 < len(plans):
            clock.sleep(PAUSE)
    return results_so_far


def record(
    uri: str,
    folder: Path,
    course: Course | FlightPlan,
    count: int,
    seed: int = 0,
    *,
    clock: Clock | None = None,
    say: Callable[[str], None] = print,
    care: Care = Care(),  # noqa: B008
) -> list[FlightResult]:
    """Connects, checks, flies and files; Ctrl-C lands, a second one stops the motors.

    Args:
        uri: see `Crazyflie`.
        folder: where to write; see `flights`.
        course: what to fly; the room of a flight plan narrows the limits of `care`.
        count: flights.
        seed: of the steps.
        clock: the computer's by default.
        say: called with messages.
        care: what is expected before the first take-off.

    Raises:
        InputError: no connection, an unfit drone, or a reference beyond the limits.
        WriteError: rows cannot be written.
    """
    settings: dict[str, object]
    if isinstance(course, Course):
        plans = [course.plan(seed + number) for number in range(count)]
        settings = {**course.settings, **care.settings}
    else:
        care = care._replace(limits=within(course.room, care.limits))
        plans = [of_flight_plan(course)] * count
        settings = {"plan": Path(course.name).name, "duration": course.seconds}
    for plan in plans:
        checked_plan(plan, care.limits)
    session_record = results.record(seed=seed, inputs=[], settings=settings)
    clock = clock or WallClock()
    with (
        closing(Crazyflie(uri, clock, cache.folder() / "crazyflie")) as drone,
        stop_requests() as stops,
    ):
        how: Any = {"clock": clock, "stops": stops, "say": say, "care": care}
        return flights(drone, plans, folder, session_record, **how)


def _next_name(folder: Path) -> str:
    occupied = {path.name.split(".")[0] for path in folder.glob("flight_*")}
    names = (f"flight_{number:02d}" for number in range(1, 10_000))
    return next(name for name in names if name not in occupied)


def _filed(folder: Path, name: str, ending: Ending, count: int) -> FlightResult:
    rows = folder / f"{name}{row_files.SUFFIX}"
    try:
        path, notes = row_files.write_flight(rows, ended=ending.reason)
    except InputError as error:
        return FlightResult(name, ending, count, None, (str(error),))
    return FlightResult(name, ending, count, path, notes)
