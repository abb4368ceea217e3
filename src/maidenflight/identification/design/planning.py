"""Planning of a flight that tells most of a drone, within a room.

Each manoeuvre of a library is simulated once, on the drone and on others about it. Those that leave
the room, tilt or lag too much on any of them are left out. The information of each is that of the
one-step likelihood, with one noise model for all; `optimal_design` chooses the seconds. What is to
be expected is then told as `identify` tells it, by simulating the whole plan and as many seconds of
hover.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Array, Float

from maidenflight.errors import InputError
from maidenflight.flights import flight_plan
from maidenflight.flights.flight_plan import REST, Block, ExpectedWidths, Extremes, FlightPlan
from maidenflight.flights.log import Flight
from maidenflight.flights.manoeuvres import HOVER, Manoeuvre, library
from maidenflight.flying.firmware_pilot import RATE
from maidenflight.flying.recording import flight_log, fly_plans, must_divide, record_plan
from maidenflight.flying.rows import Rows
from maidenflight.identification.design import optimal_design
from maidenflight.identification.design.flight_limits import (
    LOWEST,
    MARGIN,
    FlightLimits,
    extremes_of,
    worst_of,
)
from maidenflight.identification.identify import expected_intervals
from maidenflight.identification.likelihood import one_step, selection
from maidenflight.identification.methods import Likelihood
from maidenflight.identification.outcome.plausible import UNIFORM, prior_ranges
from maidenflight.identification.signals.flight_signals import stride, undo_filter_delay
from maidenflight.identification.unknowns import UNKNOWNS, physical_bounds
from maidenflight.parameters import replace as changed
from maidenflight.simulator.realities.virtual_drone import VirtualDrone, virtual_drone

MANOEUVRE_DURATION = 9.0
"""Seconds for which each manoeuvre is simulated, the rest after it not counted: by definition of
the circle three times round (flights/manoeuvres.py)."""
CHUNK = 2.0
"""Manoeuvres last multiples of this [s]."""
SHORTEST_ROUND = 12.0
"""Length of a round below which there is one only [s]: four chunks, each with a rest; chosen."""
SLOWER = (1.5, 1.4, 1.3, 1.2, 1.1, 1.05)
"""Factors of the motors' lag; the slowest drone that still hovers calmly must be safe too. With
these and `OTHERS` the limits hold on 37 virtual drones of 40, and the rest do not hover calmly
(paper/notes/identification.md#planned-flights)."""
OTHERS = 8
"""Virtual drones about the planned one on which the limits must hold too, as far as the PID
holds them in a hover: the drone of the plan will hover. Measured with `SLOWER`."""
LESS_LATENCY = (0.5, 0.25, 0.0)
"""Shares of a guessed latency that are tried where the PID does not hold a drone: halved twice,
then none; chosen."""


@dataclass(frozen=True)
class PlanResult:
    """A plan and how it was chosen."""

    plan: FlightPlan
    left_out: dict[str, str]
    """What manoeuvres that do not fit exceed, by name."""
    unidentifiable: tuple[str, ...]
    """Parameters of interest of which the plan says less than is plausible beforehand."""
    excess: float
    """Of the approximate design over the optimum, by the equivalence theorem."""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Request:
    """Request for a plan."""

    room: tuple[float, float, float]
    """Width, depth and height [m]; the drone takes off in the middle of the floor."""
    seconds: float
    """Length of the flight, without take-off and landing [s]."""
    interest: Sequence[str] | None = None
    """Parameters to tell; those of `gaps`, else all that may be identified, by default."""
    rate: int = RATE
    """Rows a second of the log from which they will be identified [Hz]."""
    motors: bool = False
    """Whether motors may be excited, which only a simulated drone takes."""
    firmware: str = "2021.10"
    """Whose PID flies."""
    seed: int = 0
    """Of random steps."""
    is_named: bool = False
    """Whether the drone's latency is a guess, to be lowered if the firmware's PID could not hold
    the drone with it."""
    allowed: FlightLimits = FlightLimits()
    """Limits of the flight."""
    gaps: Sequence[str] = ()
    """Parameters that the drone's flights so far hardly tell, which are unknown too: the curve of
    thrust is where only throttle that varies tells it."""


def plan(
    drone: VirtualDrone,
    request: Request,
    key: Array,
    on_stage: Callable[[int, int, str], None] = lambda stages_done, stage_count, next_stage: None,
) -> PlanResult:
    """Proposes the flight that tells most of a drone.

    Args:
        drone: what is known of it.
        request: what is wanted.
        key: random key of the simulated noise.
        on_stage: called with stages done, stages, and what is next.

    Raises:
        InputError: a room or time that is too small, a parameter that cannot be told, or a drone
            that does not hover within these limits.
    """
    must_divide(request.rate)
    room, seconds, allowed = request.room, request.seconds, request.allowed
    height = _height(room)
    if not 2 * CHUNK <= seconds <= flight_plan.LONGEST_PLAN:
        raise InputError(
            f"{seconds:g} s of flight; expected {2 * CHUNK:g} to {flight_plan.LONGEST_PLAN:g} s."
        )
    _names(request, None)
    half_height = min(room[2] - MARGIN - height, height - LOWEST)
    half_width = min(room[:2]) / 2 - MARGIN
    library_plans = {
        manoeuvre: FlightPlan((Block(manoeuvre, MANOEUVRE_DURATION),), room, height, request.seed)
        for manoeuvre in library(half_width, half_height, request.motors)
    }
    keys = jax.random.split(key, len(library_plans) + 2)
    drone, drones, result, flights, notes = _find_calm_drone(
        drone, request, library_plans, keys, on_stage
    )
    left_out = {
        manoeuvre.name: limit
        for manoeuvre in library_plans
        if (limit := allowed.excess(result[manoeuvre], room))
    }
    manoeuvres = [manoeuvre.name for manoeuvre in library_plans]
    indices = [number for number, name in enumerate(manoeuvres) if name not in left_out]
    on_stage(OTHERS + 1, OTHERS + 3, "information of each manoeuvre")
    names = _names(request, flights[0])
    parts = _information(drone, [flights[number] for number in indices], names)
    gaps = [name for name in request.gaps if name in names]
    interest = [names.index(name) for name in request.interest or gaps or names]
    fitting = {
        list(library_plans)[number]: part for number, part in zip(indices, parts, strict=True)
    }
    on_stage(OTHERS + 2, OTHERS + 3, "flying the plan and a hover")
    while True:
        # `identify` judges by a third that it has not fitted, which must be like the others.
        rounds = selection.HELD_OUT if seconds >= selection.HELD_OUT * SHORTEST_ROUND else 1
        blocks, excess = _blocks(fitting, seconds, interest, rounds)
        blocks = sorted(blocks, key=lambda block: _agility(result[block.manoeuvre]))
        proposal = FlightPlan(tuple(blocks) * rounds, room, height, request.seed)
        rows = [
            fly_plans(drone, [proposal], keys[-1:], request.firmware)[0].rows for drone in drones
        ]
        extremes = worst_of([extremes_of(part) for part in rows])
        # One after the other they may do what none does alone.
        wrong = _beyond(proposal, rows, allowed) if allowed.excess(extremes, room) else {}
        wrong.pop(Manoeuvre(HOVER), None)
        if not wrong:
            break
        left_out |= {manoeuvre.name: limit for manoeuvre, limit in wrong.items()}
        fitting = {manoeuvre: part for manoeuvre, part in fitting.items() if manoeuvre not in wrong}
    proposal, unidentifiable = _expecting(
        drone, replace(proposal, extremes=extremes), keys[-2:], request, names
    )
    return PlanResult(proposal, left_out, unidentifiable, excess, tuple(notes))


def _find_calm_drone(
    drone: VirtualDrone,
    request: Request,
    library_plans: Mapping[Manoeuvre, FlightPlan],
    keys: Array,
    on_stage: Callable[[int, int, str], None],
) -> tuple[VirtualDrone, list[VirtualDrone], dict[Manoeuvre, Extremes], list[Flight], list[str]]:
    """The drone as the PID holds it, the results of `_simulate_library`, and notes.

    Raises:
        InputError: it does not hover within the limits.
    """
    limit = ""
    for share in (1.0, *(LESS_LATENCY if request.is_named else ())):
        drone_model = _with_latency(drone, share)
        drones, extremes, flights = _simulate_library(
            drone_model, request, library_plans, keys, on_stage
        )
        limit = request.allowed.unrest(extremes[Manoeuvre(HOVER)], request.room)
        if limit:
            continue
        note = (
            f"the firmware's PID does not hold {drone.name} with a latency of "
            f"{1e3 * float(drone.parameters.latency):.3g} ms; planned with "
            f"{1e3 * float(drone_model.parameters.latency):.3g} ms, since yours is held"
        )
        return drone_model, drones, extremes, flights, [note] if share < 1.0 else []
    raise InputError(
        f"{drone.name}: in simulation hover already exceeds a limit ({limit}). Give "
        "a larger --room, or check the drone's parameters."
    )


def _blocks(
    fitting: Mapping[Manoeuvre, Float[np.ndarray, "d d"]],
    seconds: float,
    of: Sequence[int],
    rounds: int,
) -> tuple[list[Block], float]:
    """Manoeuvres of a round, and the excess of the design before it was rounded."""
    parts = np.stack(list(fitting.values()))
    before = UNIFORM * np.eye(parts.shape[1])
    design = optimal_design.optimal(parts, before, seconds, of)
    lasting = optimal_design.rounded(design, CHUNK, REST, seconds / rounds)
    blocks = [
        Block(manoeuvre, float(each))
        for manoeuvre, each in zip(fitting, lasting, strict=True)
        if each > 0
    ]
    return blocks, optimal_design.excess(parts, before, design, of)


def _beyond(
    proposal: FlightPlan, rollouts: Sequence[Rows], allowed: FlightLimits
) -> dict[Manoeuvre, str]:
    """The manoeuvres of a plan during which, or in the rest after which, it exceeds a limit."""
    result, first = {}, 0
    for block in proposal.blocks:
        end = first + round((block.seconds + REST) * RATE)
        parts = [
            jax.tree.map(lambda part, some=slice(first, end): part[some], rows) for rows in rollouts
        ]
        worst = worst_of([extremes_of(part) for part in parts])
        if limit := allowed.excess(worst, proposal.room):
            result[block.manoeuvre] = limit
        first = end
    return result


def _with_latency(drone: VirtualDrone, share: float) -> VirtualDrone:
    latency = np.float32(share * float(drone.parameters.latency))
    return replace(drone, parameters=changed(drone.parameters, latency=latency))


def _slower(drone: VirtualDrone, factor: float) -> VirtualDrone:
    """The drone with slower motors, under one name for all factors."""
    lag = np.float32(factor * float(drone.parameters.motor_time_constant))
    slow = changed(drone.parameters, motor_time_constant=lag)
    return replace(drone, name=f"{drone.name}, slower", parameters=slow)


def _simulate_library(
    drone: VirtualDrone,
    request: Request,
    library_plans: Mapping[Manoeuvre, FlightPlan],
    keys: Array,
    on_stage: Callable[[int, int, str], None],
) -> tuple[list[VirtualDrone], dict[Manoeuvre, Extremes], list[Flight]]:
    """The drone and those about it that hover, how far each manoeuvre goes on any, and its logs."""
    drones: list[VirtualDrone] = []
    result: dict[Manoeuvre, Extremes] = {}
    flights: list[Flight] = []
    others = about(drone)
    slower = [_slower(other, factor) for other in (drone, others[0]) for factor in SLOWER]
    slowest: set[str] = set()
    for number, other in enumerate([drone, *others, *slower]):
        if number > OTHERS and other.name in slowest:
            continue
        on_stage(
            min(number, OTHERS), OTHERS + 3, f"{len(library_plans)} manoeuvres on {other.name}"
        )
        rollouts = fly_plans(
            other, list(library_plans.values()), keys[: len(library_plans)], request.firmware
        )
        far = {
            manoeuvre: extremes_of(each.rows)
            for manoeuvre, each in zip(library_plans, rollouts, strict=True)
        }
        is_calm = not request.allowed.unrest(far[Manoeuvre(HOVER)], request.room)
        if number and not is_calm:
            continue
        if number > OTHERS:
            slowest.add(other.name)
        drones.append(other)
        result = {key: worst_of([result.get(key, here), here]) for key, here in far.items()}
        if number == 0:
            flights = [
                flight_log(each, manoeuvre.name, request.rate, keys[0])
                for manoeuvre, each in zip(library_plans, rollouts, strict=True)
            ]
            if not is_calm:
                break
    return drones, result, flights


def about(drone: VirtualDrone) -> list[VirtualDrone]:
    """Draws virtual drones about one, on which its plan must be safe too."""
    return [
        replace(virtual_drone(seed, "virtual", drone.parameters), thrust_law=drone.thrust_law)
        for seed in range(1, OTHERS + 1)
    ]


def _height(room: tuple[float, float, float]) -> float:
    """The middle of the heights that may be flown."""
    if not all(0.8 <= size <= 100.0 for size in room):
        raise InputError(
            f"a room of {'x'.join(f'{size:g}' for size in room)} m; expected 0.8 to 100 m each "
            f"way, of which {MARGIN:g} m at each wall stay free."
        )
    return min(1.0, round((room[2] - MARGIN + LOWEST) / 2, 2))


def _names(request: Request, flight: Flight | None) -> tuple[str, ...]:
    """Parameters that are unknown together, by what a log shows; all there are without a log.

    Raises:
        InputError: one of interest is not among them.
    """
    parameter_groups = (selection.WITH_KNOWN_LAG, selection.GROUPS)
    if flight is not None:
        parameter_groups = parameter_groups[flight.accelerometer is None :][:1]
    groups = (names for some in parameter_groups for group in some.values() for names in group)
    further = (name for name in request.gaps if name in UNKNOWNS)
    names = tuple(dict.fromkeys((*selection.ALWAYS, *groups, *further)))
    for name in request.interest or ():
        if name not in names:
            raise InputError(
                f"{name}: not a parameter that "
                f"{'a plan' if flight is None else 'a log at this rate'} can identify; "
                f"{', '.join(names)} are."
            )
    return names


def _agility(extremes: Extremes) -> float:
    """By which manoeuvres are put in order, calm ones first."""
    return extremes.tilt + 0.2 * extremes.speed + extremes.at_limits


def _information(
    drone: VirtualDrone, flights: Sequence[Flight], names: Sequence[str]
) -> Float[np.ndarray, "m d d"]:
    """Information of a second of each flight, in widths of the plausible ranges."""
    bounds = physical_bounds(drone.parameters)
    priors = prior_ranges(drone.parameters, {name: bounds[name] for name in names})
    widths = np.array([priors[name][1] - priors[name][0] for name in names])
    if all(
        flight.accelerometer is not None or flight.rotor_speed is not None for flight in flights
    ):
        flights = [undo_filter_delay(flight) for flight in flights]
    objective = one_step.one_step_objective(flights, Likelihood())
    _, _, curvatures = objective.derivatives(drone.parameters, names)
    pieces = objective.segments // len(flights)
    sums = curvatures.reshape(len(flights), pieces, len(names), len(names)).sum(axis=1)
    counts = objective.rows_per_segment.reshape(len(flights), pieces).sum(axis=1)
    lengths = counts * stride(flights[0]) * flights[0].period
    return sums * (objective.rows / lengths)[:, None, None] * np.outer(widths, widths)


def _expecting(
    drone: VirtualDrone,
    proposal: FlightPlan,
    keys: Array,
    request: Request,
    names: Sequence[str],
) -> tuple[FlightPlan, tuple[str, ...]]:
    """The plan with what it and a hover tell, and the parameters that it does not tell.

    What earlier flights lack, of which `identify` asks no flight with a state, is unknown with all.
    """
    over = names if request.gaps else None
    of = []
    for each, key in ((proposal, keys[0]), (flight_plan.hovering(proposal), keys[1])):
        logs = record_plan(drone, each, key, rate=request.rate, firmware=request.firmware)
        of.append(expected_intervals(logs, start=drone.parameters, over=over))
    wanted = [name for name in of[0] if request.interest is None or name in request.interest]
    expected_widths = {
        name: ExpectedWidths(
            *(np.ptp([of[0][name].interval, of[1][name].interval, of[0][name].prior], axis=1) / 2)
        )
        for name in wanted
    }
    unidentifiable = tuple(name for name in wanted if not of[0][name].identifiable)
    return replace(proposal, expected=expected_widths), unidentifiable
