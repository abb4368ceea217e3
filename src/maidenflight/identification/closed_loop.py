"""Parameters with which simulated policies behave in the loop as the real ones did.

The likelihood judges a drone by the next 10 ms. A policy closes a loop around it, in which small
errors of lag, latency and noise decide whether an oscillation dies out or grows. Where the policies
of the logged flights are known, they are flown in simulation, and how they behave is compared:
standard deviations of rates, torques, tilt and estimates. Flight times are no part of it.
Parameters are those whose simulated flights behave most alike (indirect inference, Gourieroux,
Monfort and Renault 1993), with what was identified before as the prior's mean. The random numbers
of all simulations are the same, so that the comparison is a smooth function of the parameters.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import tree
from jaxtyping import Array, Float

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.flying import engine
from maidenflight.flying.rows import Rows
from maidenflight.identification.behaviour import (
    BEHAVIOUR,
    EDGE_S,
    LONGEST_S,
    SHORTEST_S,
    attitude_delay,
    behaviour,
    mean_behaviour,
    stacked,
)
from maidenflight.identification.drone_file import (
    CLOSED_LOOP,
    DroneFile,
    Estimate,
    Search,
    Source,
)
from maidenflight.identification.posterior import Posterior
from maidenflight.parameters import Parameters, replace
from maidenflight.policy import Policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.controllers.interface import ControlInterface
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.failures import BACKUP, excursion

PRIOR: Mapping[str, tuple[str, float]] = {
    "latency": ("added", 0.004),
    "motor_time_constant": ("factor", 0.2),
    "position_walk": ("factor", 0.4),
    "velocity_walk": ("factor", 0.4),
    "gyro_noise": ("factor", 0.4),
    "actuator_noise": ("factor", 0.4),
}
"""What is found, and the standard deviation of its prior: of an addition [s], or of the logarithm
of a factor. It allows for errors of the model, which the likelihood's narrow intervals do not."""
SMALLEST_SCALE = 0.05
"""Of what policies differ by in a standard deviation, as a logarithm."""
LARGE = 1.5
"""Differences, in their scales, beyond which one weighs less (Huber 1964; R's manual of MASS)."""
WIDTH, FARTHEST, NEAR = 0.25, 0.75, 0.05
"""Of a difference quotient, of a Gauss-Newton step at most, and of the step that ends the search
[standard deviations of the prior]."""


@dataclass(frozen=True)
class ClosedLoop:
    """Settings of `match`."""

    flights: int = 24
    """Simulated flights of each policy."""
    steps: int = 8
    """Most Gauss-Newton steps."""


class Match(NamedTuple):
    """What `match` found."""

    drones: Parameters
    """The start's, with the estimates in place."""
    estimates: Mapping[str, tuple[float, float]]
    """Value and standard error of each parameter of `PRIOR` that the drone has, from how policies
    differ; and of `estimator_delay`, from how flights do."""
    policies: int
    """Policies that were compared."""
    flights: int
    """Their logged flights."""
    before: Float[np.ndarray, "7"]
    """Median over policies of log(simulated / logged), of each of `BEHAVIOUR`, at the start."""
    after: Float[np.ndarray, "7"]
    """The same at the end."""
    cost: tuple[float, float]
    """Mean squared difference in its scale, start and end; large ones weigh less."""
    evaluations: int
    """Simulations of all policies."""

    def put_into(self, start: DroneFile, source: Source, record: Mapping[str, Any]) -> DroneFile:
        """Returns the drone that the search began with, with what was found in place.

        Args:
            start: its file.
            source: the flights, where that names none.
            record: how the match was made.
        """
        estimates, posterior = dict(start.estimates), dict(start.posterior)
        for name, (value, error) in self.estimates.items():
            old = estimates.get(name)
            ends = max(value - 1.96 * error, 0.0), value + 1.96 * error
            between = 0.0 if old is None else old.between_sd
            estimates[name] = Estimate(value, ends, (value,), between)
            if name in posterior:
                samples = posterior[name]
                unit = (samples - samples.mean()) / (samples.std() or 1.0)
                posterior[name] = np.maximum(value + error * unit, 0.0)
        changes = {name: np.float32(value) for name, (value, _) in self.estimates.items()}
        return dataclasses.replace(
            start,
            parameters=replace(start.parameters, **changes),
            estimates=estimates,
            posterior=Posterior(posterior),
            source=start.source or source,
            search=Search(CLOSED_LOOP, self.cost[1], self.flights, self.evaluations),
            record=record,
        )


def match(
    flight: Mapping[str, Sequence[Flight]],
    policies: Mapping[str, Policy],
    drones: Parameters,
    key: Array,
    settings: ClosedLoop | None = None,
    controller_for: Callable[[ControlInterface], Controller] = control.controller_for,
    on_step: Callable[[int, int, float], None] | None = None,
    every: Sequence[Flight] = (),
) -> Match:
    """Finds the parameters of `PRIOR` with which policies behave as they did.

    Before, the age of the drone's estimates is measured in all its logs, where it is above
    three standard errors: lag and latency, which act on rate PIDs too, would have to
    stand for it.

    Costs settings.steps x (1 + parameters) simulations of all policies, compiled once.

    Args:
        flight: the flights of each policy, as of `flights_of_policies`.
        policies: of one kind, by name.
        drones: the identified drone, a point or stacked along a first axis, such as its trims, of
            which each simulated flight draws one.
        key: random key.
        settings: how much is simulated.
        controller_for: the controller of a policy's interface.
        on_step: called with (steps done, steps, cost).
        every: flights of that drone by any controller, which tell its estimates' age; `flight` if
            there are none.

    Raises:
        InputError: no policy flew long enough, or the policies are of different kinds.
    """
    settings = settings or ClosedLoop()
    age = attitude_delay(every or [piece for own in flight.values() for piece in own])
    estimates: dict[str, tuple[float, float]] = {}
    if age is not None and age[0] > 3.0 * age[1]:
        estimates["estimator_delay"] = age
        drones = replace(drones, estimator_delay=np.full_like(drones.estimator_delay, age[0]))
    drone_samples = (
        drones if np.ndim(drones.mass) else tree.map(lambda leaf: np.asarray(leaf)[None], drones)
    )
    nominal = tree.map(lambda leaf: np.asarray(leaf)[0], drone_samples)
    means = {name: mean_behaviour(flights, nominal) for name, flights in flight.items()}
    logged = {name: mean for name, mean in means.items() if mean is not None}
    if not logged:
        raise InputError(
            f"no policy flew for {SHORTEST_S + 2 * EDGE_S:g} s in these logs, of which "
            f"{len(flight)} of {len(policies)} policies have any. Give logs with the policies that "
            "flew them."
        )
    simulate = _simulation(
        [policies[name] for name in logged], drone_samples, key, settings, controller_for
    )
    targets = np.stack(list(logged.values()))
    names = [name for name in PRIOR if float(np.mean(getattr(drone_samples, name))) > 0.0]
    initial_values = [float(np.mean(getattr(drone_samples, name))) for name in names]

    def drone_at(steps: np.ndarray) -> Parameters:
        changed = {
            name: np.full_like(getattr(drone_samples, name), _moved(old, step, name))
            for name, old, step in zip(names, initial_values, steps, strict=True)
        }
        return replace(drone_samples, **changed)

    def difference(steps: np.ndarray) -> np.ndarray:
        # Policies whose simulated flights are all too short tell nothing.
        return np.nan_to_num(simulate(drone_at(steps)) - targets)

    fit = _fitted(difference, len(names), settings.steps, on_step)
    for name, old, step, error in zip(names, initial_values, fit.steps, fit.errors, strict=True):
        kind, scale = PRIOR[name]
        value = _moved(old, step, name)
        estimates[name] = value, float(error * scale * (1.0 if kind == "added" else value))
    values = {
        name: np.full_like(getattr(drones, name), value) for name, (value, _) in estimates.items()
    }
    return Match(
        replace(drones, **values),
        estimates,
        len(logged),
        sum(len(flight[name]) for name in logged),
        np.median(fit.first, axis=0),
        np.median(fit.last, axis=0),
        fit.cost,
        fit.evaluations,
    )


class _Fit(NamedTuple):
    steps: Float[np.ndarray, "n"]
    """From the start, in standard deviations of the prior."""
    errors: Float[np.ndarray, "n"]
    """Their standard errors."""
    first: Float[np.ndarray, "policies 7"]
    """Differences at the start."""
    last: Float[np.ndarray, "policies 7"]
    cost: tuple[float, float]
    """A difference's mean, start and end."""
    evaluations: int


def _fitted(
    difference: Callable[[np.ndarray], np.ndarray],
    count: int,
    most: int,
    on_step: Callable[[int, int, float], None] | None,
) -> _Fit:
    """Steps that make differences small, by damped Gauss-Newton with a standard normal prior.

    Args:
        difference: of each policy's behaviour, (policies, 7), for `count` steps.
        count: of parameters.
        most: Gauss-Newton steps.
        on_step: see `match`.
    """
    steps = np.zeros(count)
    first = now = difference(steps)
    spread = 1.4826 * np.median(np.abs(first - np.median(first, axis=0)), axis=0)
    scales = np.maximum(spread, SMALLEST_SCALE)
    began = cost = _cost(first / scales, steps)
    evaluations, damping = 1, 1.0
    hessian, scores = np.eye(count), np.zeros((len(first), count))
    for number in range(most):
        slopes = np.stack(
            [(difference(steps + WIDTH * axis) - now) / WIDTH / scales for axis in np.eye(count)]
        )
        weights = 1.0 / np.maximum(1.0, np.abs(now / scales) / LARGE)
        scores = np.einsum("ipb,pb->pi", slopes, weights * now / scales)
        hessian = np.einsum("ipb,jpb,pb->ij", slopes, slopes, weights) + np.eye(count)
        move = -np.linalg.solve(hessian, scores.sum(axis=0) + steps)
        move *= min(1.0, FARTHEST / np.abs(move).max())
        evaluations += count
        while damping * np.abs(move).max() > NEAR:
            trial = steps + damping * move
            there = difference(trial)
            evaluations += 1
            if (lower := _cost(there / scales, trial)) < cost:
                steps, now, cost = trial, there, lower
                break
            damping /= 2.0
        if on_step is not None:
            on_step(number + 1, most, cost / now.size)
        if damping * np.abs(move).max() <= NEAR:
            break
    # Policies are the independent units: a sandwich over them (White 1982).
    inverse = np.linalg.inv(hessian)
    errors = np.sqrt(np.diag(inverse @ (scores.T @ scores + np.eye(count)) @ inverse))
    return _Fit(steps, errors, first, now, (began / now.size, cost / now.size), evaluations)


def _moved(old: float, step: float, name: str) -> float:
    """A parameter so many standard deviations of its prior from its old value."""
    kind, scale = PRIOR[name]
    return float(max(old + step * scale, 0.0) if kind == "added" else old * np.exp(step * scale))


def _cost(differences: np.ndarray, steps: np.ndarray) -> float:
    """Twice Huber's loss, and the prior's."""
    size = np.abs(differences)
    loss = np.where(size < LARGE, size**2, 2.0 * LARGE * size - LARGE**2)
    return float(loss.sum() + steps @ steps)


def _simulation(
    policies: Sequence[Policy],
    drones: Parameters,
    key: Array,
    settings: ClosedLoop,
    controller_for: Callable[[ControlInterface], Controller],
) -> Callable[[Parameters], Float[np.ndarray, "policies 7"]]:
    """A function from drones to the mean behaviour of each policy's flights there.

    Which of the drones a flight draws does not change from call to call. NaN where all flights of
    a policy are too short.
    """
    together = stacked(policies)
    controller = controller_for(policies[0].interface)
    period = 1.0 / policies[0].interface.rate
    rows = round((LONGEST_S + 2 * EDGE_S) / period)
    nominal = control.in_fitting_steps(tree.map(lambda leaf: leaf[0], drones), controller)
    oldest = float(np.max(drones.estimator_delay))
    env = Environment.matching(
        nominal,
        tasks.paper_circle(),
        controller,
        spec=policies[0].spec,
        estimator_memory=2 + int(np.ceil(oldest * Environment.estimate_rate)) if oldest else 0,
    )
    draw_key, flight_key = jax.random.split(key)
    shape = (len(policies), settings.flights)
    drone_indices = np.asarray(jax.random.randint(draw_key, shape, 0, len(drones.mass)))
    keys = jax.random.split(flight_key, shape)

    @jax.jit
    @partial(jax.vmap, in_axes=(0, 0, 0))
    @partial(jax.vmap, in_axes=(None, 0, 0))
    def fly(policy: Policy, drone: Parameters, key: Array) -> Rows:
        return engine.simulate(env, lambda observation, _: policy(observation), drone, key, rows)

    def simulate(drones: Parameters) -> np.ndarray:
        steps = np.broadcast_to(np.float32(nominal.time_step), np.shape(drones.mass))
        fitting = tree.map(np.asarray, replace(drones, time_step=steps))
        flights = tree.map(
            np.asarray, fly(together, tree.map(lambda leaf: leaf[drone_indices], fitting), keys)
        )
        out = np.full((len(policies), len(BEHAVIOUR)), np.nan)
        for policy in range(len(policies)):
            observation = [
                _until_it_falls(flights, policy, flight, nominal, period)
                for flight in range(settings.flights)
            ]
            available_channels = [channel for channel in observation if channel is not None]
            if available_channels:
                out[policy] = np.mean(available_channels, axis=0)
        return out

    return simulate


def _until_it_falls(
    flights: Rows, policy: int, flight: int, drone: Parameters, period: float
) -> np.ndarray | None:
    """Behaviour of one simulated flight until it tilts too far."""
    names = ("position", "velocity", "attitude", "body_rates", "ratio")
    rows = [getattr(flights, name)[policy, flight] for name in names]
    # As the drone's guard ends a real flight, which does not look at the distance.
    fallen = BACKUP.trips(excursion(rows[0], rows[2], rows[3], rows[0]))["tilt"]
    end = int(np.argmax(fallen)) if fallen.any() else len(fallen)
    return behaviour(*(row[:end] for row in rows), drone, period)  # type: ignore[arg-type]
