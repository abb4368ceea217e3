"""How long policies would fly on the real drone: a judge of drones in closed loop.

Flight times of policies that were not trained on a drone are a harder test of it than replays: an
error in its lag or its thrust feeds back through the policy until the guard trips. Policies fly
here under `Conditions`. Instants of the history are one control period apart and hold the network's
raw output; the guard reads the estimates 100 times a second, between two actions too; the reference
starts at its beginning, for the authors' policies at full speed.
"""

import hashlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import islice, starmap

import jax
import numpy as np
import polars
from jax import tree
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from maidenflight import inputs
from maidenflight.errors import InputError, first_few
from maidenflight.experiments import drones as drones_of_file
from maidenflight.experiments.conditions import CURRENT, Conditions
from maidenflight.experiments.policies import read_policies
from maidenflight.experiments.transfer import MAX_DURATION_S
from maidenflight.flying import guarded
from maidenflight.flying.guarded import FlightOutcome
from maidenflight.flying.scenario import Start
from maidenflight.inputs import PATHS, StrPath
from maidenflight.parameters import Parameters, replace
from maidenflight.policy import Policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.controllers.interface import ControlInterface
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import battery
from maidenflight.simulator.tasks import failures, tasks
from maidenflight.simulator.tasks.failures import END_REASONS, Guard
from maidenflight.simulator.tasks.tasks import Task

GUARD_RATE = 100
"""Rate [Hz] of the guard, of the authors' logs and of the estimates."""
LANES = 16
"""Trials of a policy that one compiled program flies together, until the last of them has ended."""
AT_ONCE = {"cpu": 1}
"""Policies that a device flies together, by platform."""
AT_ONCE_ELSEWHERE = 64


def _of_files(
    path: StrPath, names: Sequence[str] | None, policy_tasks: Sequence[Task] | None
) -> tuple[Sequence[Policy], Sequence[str], Sequence[Task]]:
    """Policies of a file or folder, with names and tasks where none are given."""
    files = read_policies([path])
    trained, _ = files.choose_tasks(None)
    return files.own, names or files.own_names, policy_tasks or [*map(tasks.find_task, trained)]


def predict_flight_times(
    policies: Sequence[Policy] | StrPath,
    drone: Parameters | StrPath,
    key: Array | int = 0,
    *,
    trials: int = 16,
    duration: float = MAX_DURATION_S,
    conditions: Conditions = CURRENT,
    names: Sequence[str] | None = None,
    policy_tasks: Sequence[Task] | None = None,
    on_policy: Callable[[int, int], None] | None = None,
) -> polars.DataFrame:
    """Flies every policy until a guard trips.

    A policy's flights depend on the key, on its weights and on the drone, not on the policies
    beside it nor on how many devices share them. Compiled once for policies of one control
    structure, rate, history and layer sizes, whatever their number, the trials, the duration and
    the drone; an estimator that is late (`estimator_delay`) is another compilation.

    Args:
        policies: of any control structures, histories and layer sizes; or a policy file or a folder
            of them, each of which flies what it was trained for.
        drone: a point, or an ensemble stacked along a first axis, from which each trial draws one;
            or the name or file of a drone, of which trials draw as the command `predict` does.
        key: random key, or a whole number that makes one.
        trials: flights of each policy.
        duration: longest flight [s].
        conditions: firmware, first states and guard.
        names: what table and errors call the policies; policy_1, policy_2, ... by default.
        policy_tasks: what each flies; the circle of the paper by default, as the authors' did.
        on_policy: called with (policies done, policies).

    Returns:
        One row a flight: policy, control, duration [s], end_reason, trial and drone (its number in
        the ensemble, from 1); position_error and estimated_error, mean distances from the
        set-point of the true position and of the drone's estimate [m]; and, by the estimates that
        guards look at, largest_tilt [rad], largest_body_rate [rad/s] and largest_distance [m].

    Raises:
        InputError: no policy, trial or time, names that do not tell the policies apart, or a rate
            that does not divide 100 Hz.
    """
    if isinstance(policies, PATHS):
        policies, names, policy_tasks = _of_files(policies, names, policy_tasks)
    if isinstance(drone, PATHS):
        drone = drones_of_file.possible_drones(drone, drones_of_file.choose_prediction(drone), 0)
    key = inputs.random_key(key)
    names = list(names or (f"policy_{number}" for number in range(1, len(policies) + 1)))
    if not policies or trials < 1 or not len(set(names)) == len(names) == len(policies):
        raise InputError(
            f"{len(policies)} policies, {len(names)} names and {trials} trials; expected at least "
            "one, and a name for each."
        )
    rows = round(duration * GUARD_RATE)
    if rows < 1:
        raise InputError(f"flights of {duration} s, expected at least {1 / GUARD_RATE} s.")
    for name, policy in zip(names, policies, strict=True):
        if GUARD_RATE % policy.interface.rate:
            raise InputError(
                f"{name}: {policy.interface.name} at {policy.interface.rate} Hz, which does not "
                f"divide the guard's {GUARD_RATE} Hz."
            )
    drones = drone if np.ndim(drone.mass) else tree.map(lambda leaf: np.asarray(leaf)[None], drone)
    limits = guarded.Limits(np.int32(rows), Guard(*map(np.float32, conditions.guard)))  # type: ignore[arg-type]
    flown_tasks = list(policy_tasks or [tasks.paper_circle()] * len(policies))
    kinds: dict[tuple, list[int]] = {}
    for index, (policy, task) in enumerate(zip(policies, flown_tasks, strict=True)):
        kinds.setdefault((policy.interface, policy.spec, task), []).append(index)
    by_policy: dict[int, FlightOutcome] = {}
    drawn: dict[int, np.ndarray] = {}
    for places in kinds.values():
        kind = [policies[index] for index in places]
        settings = key, trials, limits, conditions.start, conditions.controller_for
        every = _fly_kind(kind, flown_tasks[places[0]], drones, *settings)
        for index, (outcome, indices) in zip(places, every, strict=True):
            by_policy[index], drawn[index] = outcome, indices
            if on_policy is not None:
                on_policy(len(by_policy), len(policies))
    end, largest, *distances = tree.map(
        lambda *parts: np.concatenate(parts), *(by_policy[index] for index in range(len(policies)))
    )
    return polars.DataFrame(
        {
            "policy": np.repeat(names, trials).tolist(),
            "control": np.repeat([policy.interface.name for policy in policies], trials).tolist(),
            # A printed table shows the first four and the last four columns.
            "duration": end.steps / GUARD_RATE,
            "end_reason": [END_REASONS[reason] for reason in end.reason],
            "trial": np.tile(np.arange(1, trials + 1), len(policies)),
            "drone": np.concatenate([drawn[index] + 1 for index in range(len(policies))]),
            **failures.largest(tree.map(lambda part: part[:, None], largest)),
            **{
                name: (np.asarray(distance, np.float64) / end.steps).round(6)
                for name, distance in zip(failures.ERRORS, distances, strict=True)
            },
        }
    )


def _fly_kind(
    policies: Sequence[Policy],
    task: Task,
    drones: Parameters,
    key: Array,
    trials: int,
    limits: guarded.Limits,
    start: Start,
    controller_for: Callable[[ControlInterface], Controller],
) -> Iterator[tuple[FlightOutcome, np.ndarray]]:
    """Returns how each policy's flights went, and the places of their drones; policies of one kind.

    They fly in portions of one size: the same program flies few and many, in bounded memory.
    """
    # The guard looks between two actions.
    structure = controller_for(policies[0].interface).acting_at(GUARD_RATE)
    # No step sees two commands if there are two (`latency.in_step`).
    longest = min(float(np.max(drones.time_step)), 0.5 / structure.command_rate)
    step = np.float32(control.time_step(structure, longest))
    late = bool(np.any(np.asarray(drones.estimator_delay) > 0))
    drones = tree.map(
        np.asarray, replace(drones, time_step=np.broadcast_to(step, np.shape(drones.mass)))
    )
    nominal = tree.map(lambda leaf: leaf[0], drones)
    memory = _MEMORY if late else 0
    # Of PIDs that ask for more than u = 1 the motors give what the battery allows.
    law = battery.law_for(structure.interface.full_scale_counts)
    env = Environment.matching(
        nominal,
        task,
        structure,
        estimator_memory=memory,
        spec=policies[0].spec,
        thrust_law=law,
    )
    laid = NamedSharding(guarded.mesh(), PartitionSpec(guarded.POLICIES))
    size = laid.mesh.size * AT_ONCE.get(jax.default_backend(), AT_ONCE_ELSEWHERE)
    policies = [tree.map(np.asarray, policy) for policy in policies]
    own = np.array([_identity(policy) for policy in policies], np.uint32)
    blocks = -(-trials // LANES)

    def portion(first: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, Array]:
        places, block = np.divmod(np.arange(first, first + size), blocks)
        numbers = block[:, None] * LANES + np.arange(LANES)
        # The last portion is filled up with flights that end at once.
        is_active = (numbers < trials) & (places < len(policies))[:, None]
        places = np.minimum(places, len(policies) - 1)
        drone_indices, keys = guarded.draw(
            key, own[places], numbers.astype(np.uint32), np.int32(len(drones.mass))
        )
        return places, is_active, np.asarray(drone_indices), keys

    def fly(
        places: np.ndarray, is_active: np.ndarray, drone_indices: np.ndarray, keys: Array
    ) -> FlightOutcome:
        flying = tree.map(lambda *leaves: np.stack(leaves), *(policies[index] for index in places))
        flights = guarded.Trials(
            flying, tree.map(lambda leaf: leaf[drone_indices], drones), keys, is_active
        )
        every = GUARD_RATE // policies[0].interface.rate
        return guarded.fly_together(env, every, jax.device_put(flights, laid), limits, start)

    # Drones are drawn first: waiting for a draw would be waiting for the flights before it.
    portions = [portion(first) for first in range(0, blocks * len(policies), size)]
    landed = (
        tree.map(lambda part, index=index: part[index], flights)
        for flights in _landed(starmap(fly, portions))
        for index in range(size)
    )
    indices = (row for portion in portions for row in portion[2])
    for _ in policies:
        flights = islice(landed, blocks)
        yield (
            tree.map(lambda *parts: np.concatenate(parts)[:trials], *flights),
            np.concatenate(list(islice(indices, blocks)))[:trials],
        )


_UNDER_WAY = 8
"""Portions begun before the first of them has landed: devices that are ahead need not wait, and
memory is bounded."""


def _landed(begun: Iterable[FlightOutcome]) -> Iterator[FlightOutcome]:
    under_way: deque[FlightOutcome] = deque()
    for flights in begun:
        under_way.append(flights)
        if len(under_way) > _UNDER_WAY:
            yield tree.map(np.asarray, under_way.popleft())
    for flights in under_way:
        yield tree.map(np.asarray, flights)


def _identity(policy: Policy) -> int:
    """A number of 32 bits that stands for what a policy is, so that its flights are its own."""
    kind = f"{policy.interface.name} {policy.interface.rate} {policy.spec.identity}"
    digest = hashlib.sha256(kind.encode())
    for leaf in tree.leaves(policy):
        digest.update(np.asarray(leaf, "<f4").tobytes())
    return int.from_bytes(digest.digest()[:4], "little")


_MEMORY = 7
"""Estimates at 100 Hz that hold any `estimator_delay` within its bounds, 50 ms."""


QUANTILES = (10, 25, 50, 75, 90)
"""Of the duration, in percent."""


def summary(flights: polars.DataFrame) -> polars.DataFrame:
    """Returns one row a policy, in the order of the flights.

    Args:
        flights: what `predict_flight_times` gives.

    Returns:
        policy, control, trials; mean and quantiles (`QUANTILES`, in percent) of the duration [s],
        each of which one more flight stays below with that probability, however few there were;
        the share of flights that ended by each of the reasons there are; the mean position_error
        and estimated_error [m], and the largest tilt [rad], body rate [rad/s] and distance [m].

    Source: Hyndman and Fan 1996, Sample quantiles in statistical packages (type 6). By the usual
    type 7 a band of 10 to 90 % of 16 flights holds 71 % of further ones, not 80 %.
    """
    duration, reason = polars.col("duration"), polars.col("end_reason")
    reasons = [name for name in END_REASONS if name in set(flights["end_reason"])]
    return flights.group_by("policy", "control", maintain_order=True).agg(
        polars.len().alias("trials"),
        duration.mean().alias("mean"),
        *(
            duration.map_batches(
                partial(np.quantile, q=share / 100, method="weibull"),
                return_dtype=polars.Float64,
                returns_scalar=True,
            ).alias(f"quantile_{share}")
            for share in QUANTILES
        ),
        *((reason == name).mean().alias(name) for name in reasons),
        polars.col("^(position|estimated)_error$").mean(),
        polars.col("^largest_.*$").max(),
    )


def outlives(flights: polars.DataFrame) -> Float[np.ndarray, "policies policies"]:
    """Returns the probability that a flight of one policy lasts longer than one of another.

    Of equal durations, such as two at the time limit, each counts half.

    Args:
        flights: what `predict_flight_times` gives.

    Returns:
        Row over column, in the order of the flights; 0.5 along the diagonal.

    Source: Mann and Whitney 1947, On a test of whether one of two random variables is larger.
    """
    parts = flights.partition_by("policy", maintain_order=True)
    times = [np.sort(part["duration"].to_numpy()) for part in parts]

    def share_below(other: np.ndarray, own: np.ndarray) -> float:
        ranks = [np.searchsorted(other, own, side) for side in ("left", "right")]
        return float(np.mean(ranks)) / len(other)

    return np.array([[share_below(other, own) for other in times] for own in times])


UNSURE = 0.2
"""Probability of the shorter flight from which on the two policies cannot be told apart."""


def describe_alike(
    summary: polars.DataFrame, against_best: Float[np.ndarray, "policies"]
) -> list[str]:
    """Returns a sentence on the policies that cannot be told apart from the best one.

    Args:
        summary: what `summary` returns.
        against_best: column of `outlives` of the policy with the longest mean.
    """
    names = summary["policy"].to_list()
    best = int(np.argmax(summary["mean"].to_numpy()))
    alike = [
        name for index, name in enumerate(names) if index != best and against_best[index] > UNSURE
    ]
    if not alike:
        return []
    return [
        f"{names[best]} cannot be told apart from {first_few(alike)}, whose flights outlive its "
        f"own with a probability above {UNSURE:.0%}."
    ]
