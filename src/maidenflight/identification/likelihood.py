"""Identification by maximum likelihood of one-step errors: parameters that flights under feedback
do not bias, and the noise beside.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from maidenflight.flights.log import Flight
from maidenflight.flights.windows import HISTORY, SHORTEST_HISTORY, windows
from maidenflight.identification import gradient, one_step, posterior, selection
from maidenflight.identification.bayesian import Box
from maidenflight.identification.noise_levels import noise_levels
from maidenflight.identification.objective import NormalEquations
from maidenflight.identification.one_step import OneStep
from maidenflight.identification.selection import Step
from maidenflight.parameters import Parameters, component, replace

_PILOT = 128
"""Windows on which a far start comes near the optimum."""
_COARSE, _FINE = 0.002, 0.001
"""Nominal physics steps [s] on the way and at the end. At 5 ms a command that arrives within a step
is seen so coarsely that the lag comes out 1 ms short; at 2 ms the latency is still 0.1 ms off,
which is as much as two minutes of flight leave open."""
_CLOSE = 0.02
"""Gain of log likelihood of all flights [nats] below which a step is the last: a fifth of a
standard error moves it by as much."""


@dataclass(frozen=True)
class Likely:
    """What maximum likelihood found."""

    drone: Parameters
    """The start, with the most likely values and the noise of the flights in place."""
    box: Box
    """The search box of the parameters that were identified."""
    optimum: Float[np.ndarray, "d"]
    """In the box's unit cube, as are the next two."""
    runs: list[tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n"]]]
    """Points evaluated on all windows and their values, of each trial; finely only in the best,
    which ends at the optimum."""
    value: float
    """Minus the mean log likelihood of a row at the optimum."""
    draws: Float[np.ndarray, "N d"]
    """Drones as likely as the flights leave them (Laplace's approximation with the sandwich
    covariance)."""
    spread: Float[np.ndarray, "d"]
    """Standard deviation between stretches of flight, beyond what their noise explains; in the
    parameters' units."""
    bought: tuple[Step, ...]
    """What each group of parameters bought, where the flights chose them."""
    noise: Mapping[str, float]
    """Noise fields of `drone`."""
    stretches: int
    rows: int
    start_value: float
    """Minus the mean log likelihood of a row at the start."""


class _Fit(NamedTuple):
    drone: Parameters
    box: Box
    optimum: Float[np.ndarray, "d"]
    run: tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n"]]


def bounds(start: Parameters) -> dict[str, tuple[float, float]]:
    """Physical search bounds about a drone, by component.

    Torques in units of its weight times its arm.
    """
    torque = float(start.mass * start.gravity * start.arm_length)
    around = {
        name: float(component(start, name)) for name in ("inertia_x", "inertia_y", "inertia_z")
    }
    return {
        "thrust_to_weight": (1.01, 8.0),
        "motor_time_constant": (0.003, 0.5),
        "latency": (0.0, 0.05),
        "spin_down_ratio": (0.2, 5.0),
        "motor_coasting": (0.0, 0.5),
        "torque_to_thrust": (0.0, 0.1),
        "rotor_momentum": (0.0, 0.1 * torque),
        "flapping_moment": (-0.1 * torque, 0.2 * torque),
        "rotational_damping": (0.0, 0.05 * torque),
        "thrust_linear": (0.0, 1.0),
        **{f"torque_bias_{axis}": (-0.2 * torque, 0.2 * torque) for axis in "xyz"},
        **{f"drag_{axis}": (0.0, 3.0) for axis in "xyz"},
        **{name: (0.3 * value, 3.0 * value) for name, value in around.items()},
    }


def maximise(
    flights: Sequence[Flight],
    box: Callable[[Sequence[str]], Box],
    over: Sequence[str],
    start: Parameters,
    history: int,
    evaluations: int,
    trials: int,
    generator: np.random.Generator,
    on_evaluation: Callable[[], None] | None = None,
    on_step: Callable[[Step], None] | None = None,
) -> Likely:
    """Finds the drone and the noise under which what the flights show is most likely.

    Args:
        flights: checked flights of one rate.
        box: parameters' names to their search box.
        over: the parameters; none to let the flights choose.
        start: where the first trial begins, and what is kept of the other parameters.
        history: rows of commands before a window, from which its motors' speed is inferred.
        evaluations: most evaluations of a trial.
        trials: the first begins at the start, the others at random.
        generator: random numbers.
        on_evaluation: called after each evaluation on all windows.
        on_step: called with what each group of parameters bought.

    Raises:
        InputError: too little flight.
    """
    period = flights[0].period

    def of(some: Sequence[Flight], step: float = _COARSE, every: int = 1) -> OneStep:
        return _objective(some, history, step, every)

    def fit(
        objectives: Sequence[OneStep],
        names: Sequence[str],
        first: Parameters,
        at_random: bool = False,
        close: float = 0.0,
    ) -> _Fit:
        """Climbs on one objective after another, on each until a step gains less than `_CLOSE`, or
        than `close` a row.
        """
        searched = box(names)

        def at(unit: np.ndarray) -> Parameters:
            values = zip(searched.names, searched.values(unit), strict=True)
            return replace(first, **{name: np.float32(value) for name, value in values})

        def climb(target: OneStep, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            def equations(unit: np.ndarray) -> NormalEquations:
                if on_evaluation is not None:
                    on_evaluation()
                return gradient.in_unit_cube(
                    target.normal_equations(at(unit), searched.names), searched, unit
                )

            return _climb(equations, point, evaluations, max(close, _CLOSE / target.rows))

        point = searched.unit(np.array([float(component(first, name)) for name in searched.names]))
        point = (
            generator.random(len(point))
            if at_random
            else np.clip(point, gradient.INSIDE, 1 - gradient.INSIDE)
        )
        points, values = np.empty((0, len(point))), np.empty(0)
        for target in objectives:
            points, values = climb(target, point)
            point = points[int(np.argmin(values))]
        return _Fit(at(point), searched, point, (points, values))

    coarse, everything = of(flights), of(flights, _FINE)
    pilot = of(flights, every=max(1, coarse.size // _PILOT))
    first, bought = start, []
    if not over:
        fitted, judged = _split(flights)
        training, held_out = of(fitted), of(judged)
        sample = of(fitted, every=max(1, training.size // _PILOT))

        def roughly(names: Sequence[str], first: Parameters) -> Parameters:
            return fit([sample, training], names, first, close=selection.ROUGH).drone

        over, first, bought = selection.choose(
            training, held_out, roughly, start, on_step=on_step, sample=sample
        )
    found = [fit([coarse], over, first)]
    found += [fit([pilot, coarse], over, start, at_random=True) for _ in range(trials - 1)]
    best = int(np.argmin([one.run[1].min() for one in found]))
    found[best] = fit([everything], over, found[best].drone)
    drone, searched, optimum, (_, values) = found[best]
    _, scores, curvatures = everything.derivatives(drone, searched.names)
    slope = searched.slope(optimum)
    covariance = posterior.sandwich(scores * slope, curvatures.sum(axis=0) * np.outer(slope, slope))
    draws = np.clip(
        generator.multivariate_normal(optimum, covariance, posterior.RESAMPLES, method="eigh"),
        0.0,
        1.0,
    )
    levels = noise_levels(everything.mean_products(drone), drone, period)
    return Likely(
        drone=replace(drone, **{name: np.float32(value) for name, value in levels.items()}),
        box=searched,
        optimum=optimum,
        runs=[one.run for one in found],
        value=float(values.min()),
        draws=draws,
        spread=posterior.spread(scores * everything.rows, curvatures * everything.rows),
        bought=tuple(bought),
        noise=levels,
        stretches=everything.blocks,
        rows=int(everything.rows),
        start_value=everything(start),
    )


def log_likelihood(flights: Sequence[Flight], drone: Parameters, history: int = HISTORY) -> float:
    """Mean log likelihood of a row [nats]: how well one-step predictions by a drone foresee
    flights, under the noise that suits them best.

    Args:
        flights: checked flights of one rate.
        drone: the drone; its noise does not count.
        history: rows of commands before a window, from which its motors' speed is inferred.

    Raises:
        InputError: too little flight.
    """
    return -_objective(flights, history, _FINE)(drone)


def _objective(flights: Sequence[Flight], history: int, step: float, every: int = 1) -> OneStep:
    """The objective on every so many windows, in physics steps of about so many seconds."""
    cut, period = (
        windows(flights, one_step.LENGTH, every=one_step.LENGTH, history=history),
        flights[0].period,
    )
    return OneStep(
        type(cut)(*(array[::every] for array in cut)), period, max(1, round(period / step))
    )


def _split(flights: Sequence[Flight]) -> tuple[list[Flight], list[Flight]]:
    """Flights to fit and, every third of them, to judge by.

    The longest is cut in three where there are fewer than three.

    Stretches of one flight stay together, unless there are fewer than three flights.
    """
    long_enough = [
        flight
        for flight in flights
        if len(flight) > one_step.LENGTH + max(SHORTEST_HISTORY + 1, flight.lead)
    ]
    whole: list[list[Flight]] = []
    for flight in long_enough:
        before = whole[-1][-1] if whole else None
        if before and flight.lead and before.lead and before.name == flight.name:
            whole[-1].append(flight)
        else:
            whole.append([flight])
    if len(whole) < selection.HELD_OUT:
        whole = [[flight] for flight in long_enough]
    if len(whole) < selection.HELD_OUT:
        whole = []
        for flight in flights:
            ends = [len(flight) * part // 3 for part in range(4)]
            for first, end in zip(ends[:-1], ends[1:], strict=True):
                whole.append([flight.part(first, end)])
    judged = whole[selection.HELD_OUT - 1 :: selection.HELD_OUT]
    fitted = [
        parts
        for number, parts in enumerate(whole)
        if number % selection.HELD_OUT != selection.HELD_OUT - 1
    ]
    return [part for parts in fitted for part in parts], [
        part for parts in judged for part in parts
    ]


def _climb(
    equations: Callable[[Float[np.ndarray, "d"]], NormalEquations],
    point: Float[np.ndarray, "d"],
    evaluations: int,
    close: float,
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n"]]:
    """Damped Gauss-Newton steps in the unit cube until one gains less than `close`, or fails and
    its slope promised less than that.

    How the gradient changes corrects the curvature. A step that promises hardly anything is not
    taken: to confirm it costs as much as any.

    Source: Marquardt 1963, An algorithm for least-squares estimation of nonlinear parameters.
    """
    here, damping = equations(point), 0.0
    points, values = [point], [here.loss]
    while len(points) < evaluations:
        there = gradient.step(here, point, damping)
        if len(points) > 1 and damping < 1 and here.gradient @ (point - there) < close / 4:
            break
        ahead = equations(there)
        points.append(there)
        values.append(ahead.loss)
        gain = here.loss - ahead.loss
        if gain > 0:
            point, here, damping = (
                there,
                gradient.corrected(ahead, here, there - point),
                damping / 8,
            )
            if gain < close:
                break
        elif here.gradient @ (point - there) < close:
            break
        else:
            damping = max(4 * damping, 2.0)
    return np.array(points), np.array(values)
