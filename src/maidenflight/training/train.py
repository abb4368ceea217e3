"""Training policies: one loop for all methods, with evaluation, the best policy and checkpoints.

A method is two functions, `init` and `update`, and the frozen dataclass of its settings. The random
numbers of an update depend on its number alone, so that neither the number of evaluations nor an
interruption changes what is learned.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from itertools import pairwise
from operator import itemgetter
from threading import Thread
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import tree
from jax.stages import Wrapped
from jaxtyping import Array

from maidenflight import compiler
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import Distribution
from maidenflight.simulator.tasks.tasks import Task
from maidenflight.training import analytic_gradient, distillation, ppo
from maidenflight.training import checkpoint as checkpoints
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.checkpoint import Checkpoint
from maidenflight.training.devices import placed
from maidenflight.training.distillation import Distillation
from maidenflight.training.evaluation import Evaluation, Starts, evaluate_together, starts_of
from maidenflight.training.settings import PPO, Settings
from maidenflight.training.training_spec import TrainingSpec, validate

_PARTS = 5
"""Stretches of updates between two evaluations, after each of which the user hears of training."""


class Method(NamedTuple):
    """A training method for P policies at a time, as two jitted functions.

    Stacked means with a leading axis of P.
    """

    init: Wrapped
    """(environment, settings, P stacked distributions of drones, P keys) to P stacked learners,
    each with a field `policy`."""
    update: Wrapped
    """(environment, settings, distributions, learners, P keys, first, end) to the learners after
    updates `first` to `end` - 1, whose random numbers follow from key and update alone."""
    sharding: Any
    """Of each part of a learner over the devices."""


METHODS: dict[type, Method] = {
    AnalyticGradient: Method(
        analytic_gradient.init, analytic_gradient.update, analytic_gradient.SHARDING
    ),
    Distillation: Method(distillation.init, distillation.update, distillation.SHARDING),
    PPO: Method(ppo.init, ppo.update, ppo.SHARDING),
}
"""Methods by the class of their settings."""


class Progress(NamedTuple):
    """State of training at an evaluation; arrays have one entry per policy."""

    update: int
    steps: int
    """Control periods simulated so far, all policies together."""
    score: Evaluation
    best: Policy | None = None
    """Each policy at its best evaluation so far, stacked; `None` for evaluations that are read from
    a checkpoint, except the last."""


class _State(NamedTuple):
    """State of training, as a checkpoint holds it."""

    learners: Any
    best: Policy
    best_score: Evaluation
    scores: Evaluation
    """E x P, all evaluations of all stages; not a number where they are still to come."""
    scored: np.int32
    """Number of evaluations so far."""
    going: np.ndarray
    """Whether each policy is trained in the last stage."""


def train(
    task: Task,
    controller: Controller,
    distribution: Distribution | Sequence[Distribution],
    keys: Array,
    settings: Settings | None = None,
    policy: PolicySpec | Policy = PolicySpec(),
    *,
    on_progress: Callable[[Progress], None] | None = None,
    on_update: Callable[[int, int], None] | None = None,
    checkpoint: StrPath | Checkpoint | None = None,
) -> tuple[Policy, ...]:
    """Trains one policy per key, all in one call.

    Args:
        task: the task to fly.
        controller: control structure that the policy commands.
        distribution: the drones to train over; or one for each key, of one kind, whose drones
            have the same frame and time step.
        keys: random keys, one per policy.
        settings: of the method, which is chosen by their class; default `AnalyticGradient()`.
        policy: what the policies see and remember, and their hidden layers, to train from random
            weights; or a policy from which training starts, and whose score is the first.
        on_progress: called after each evaluation; first with those of the checkpoint.
        on_update: called a few times between two evaluations with (updates done, updates), such as
            `move` of a `terminal.Bar`.
        checkpoint: file, written after each evaluation. If it exists, training resumes from it and
            ends with the same policies as without the interruption, unless `Checkpoint.restart`.
            If it is of a training that has ended and `settings.updates` is larger than its number,
            training is extended: its further updates have the learning rates that they have in a
            training of that many. `Checkpoint.members` may name those whose scores then begin anew.

    Returns:
        For each key, in order, the policy at its best evaluation (`Evaluation.beats`). Time grows
        linearly with keys and updates.

    Raises:
        InputError: policies cannot be made for this control structure; the drones' time
            step does not divide its period, or they differ in frame or time step; the checkpoint is
            of another training, of more updates, or of fewer that have not ended, or cannot be
            written; the policy commands another control structure, or the method is not by
            gradients; or the scores of a policy are no longer finite.
    """
    settings = AnalyticGradient() if settings is None else settings
    method = _method_of(settings)
    spec = validate(task, controller, distribution, keys, settings, policy)
    env, drones, from_zero = spec.env, spec.drones, spec.initial is not None
    store = checkpoint if isinstance(checkpoint, Checkpoint | None) else Checkpoint(checkpoint)
    path, fingerprint = None if store is None else store.path, spec.fingerprint()
    state, before, starts = _begin(method, spec, store, fingerprint)
    stages = checkpoints.extended(
        path, before, settings.updates, settings.evaluations, int(state.scored), from_zero
    )
    if stages != before:
        state = _extended(state, store)
    ends = checkpoints.ends(stages, settings.evaluations, from_zero)
    if to_come := len(ends) - len(state.scores.survival):
        more = np.full((to_come, len(keys)), np.float32(np.nan))
        state = state._replace(
            scores=Evaluation(*(np.concatenate([rows, more]) for rows in state.scores))
        )

    def report(state: _State, number: int) -> None:
        if on_progress is not None:
            score = Evaluation(*(value[number] for value in state.scores))
            best = state.best if number + 1 == int(state.scored) else None
            updates = _updates_of_all(state.scores, ends[: number + 1])
            steps = updates * settings.num_envs * settings.horizon
            on_progress(Progress(ends[number], steps, score, best))

    for number in range(int(state.scored)):
        report(state, number)
    to_score = range(int(state.scored), len(ends))
    parts = drones, keys, starts, state.learners
    drones, own_keys, starts, learners = (_of_members(state.going, part) for part in parts)
    learners = placed(learners, method.sharding, settings.num_envs)
    compilation = _compiling_scores(env, settings, learners.policy, starts) if to_score else None
    for number in to_score:
        first, earlier = ends[number - 1] if number else 0, learners.policy.network
        for start, end in pairwise(_parts(first, ends[number], on_update is not None)):
            learners = method.update(env, settings, drones, learners, own_keys, start, end)
            if on_update is not None:
                jax.block_until_ready(learners)
                on_update(end, ends[-1])
        if compilation is not None:
            compilation.join()
        scores = evaluate_together(env, settings.num_envs, learners.policy, starts)
        _must_have_learned(earlier, learners.policy.network, first, ends[number])
        if not np.all(np.isfinite(scores.episode_return)):
            hint = f" {path} holds the training as it was at update {first}."
            raise InputError(
                f"training diverged between updates {first} and {ends[number]}: a policy's return "
                f"is not a number.{hint if path is not None and number else ''} Train again with"
                " a smaller learning_rate, or over drones that differ less."
            )
        state = _advanced(state, learners, scores)
        if path is not None:
            checkpoints.save(path, state, fingerprint, stages)
        report(state, number)
    return tuple(tree.map(itemgetter(number), state.best) for number in range(len(keys)))


def _must_have_learned(before: Any, after: Any, first: int, end: int) -> None:
    if end > first and tree.all(tree.map(np.array_equal, before, after)):
        raise InputError(
            f"updates {first} to {end} changed nothing: no gradient of the reward is a number. "
            "jnp.linalg.norm has none at 0, jnp.sqrt(x @ x + 1e-12) has; or train by PPO."
        )


def _parts(first: int, end: int, several: bool) -> list[int]:
    """Updates at which the user hears of training: one program computes any stretch of them."""
    return sorted({int(number) for number in np.linspace(first, end, _PARTS + 1 if several else 2)})


def _method_of(settings: Settings) -> Method:
    if type(settings) not in METHODS:
        names = ", ".join(kind.__name__ for kind in METHODS)
        raise InputError(
            f"{type(settings).__name__} are not settings of a method of training; known are "
            f"{names}."
        )
    return METHODS[type(settings)]


def _begin(
    method: Method, spec: TrainingSpec, checkpoint: Checkpoint | None, fingerprint: str
) -> tuple[_State, tuple[int, ...], Starts]:
    """The state in which training begins, the stages that it has behind it, and its episodes."""
    env, settings, drones, keys = spec.env, spec.settings, spec.drones, spec.keys

    def start(stages: tuple[int, ...]) -> _State:
        # Of a checkpoint, which has stages, only shapes count.
        init = method.init if stages else partial(_init_once, method.init)
        learners = init(env, settings, drones, keys)
        if spec.initial is not None:
            copies = [spec.initial] * len(keys)
            learners = learners._replace(policy=tree.map(lambda *same: np.stack(same), *copies))
        every = stages or (settings.updates,)
        count = len(checkpoints.ends(every, settings.evaluations, spec.initial is not None))
        worst = Evaluation(*[np.full(len(keys), np.float32(-np.inf))] * len(Evaluation._fields))
        nothing = tree.map(lambda leaf: np.full((count, *leaf.shape), np.float32(np.nan)), worst)
        going = np.ones(len(keys), bool)
        return _State(learners, learners.policy, worst, nothing, np.int32(0), going)

    with ThreadPoolExecutor(1) as executor:
        earlier = None if checkpoint is None or checkpoint.restart else checkpoint.path
        if earlier is None or not os.path.lexists(earlier):
            # Meanwhile XLA compiles what makes learners and starts, which takes as long.
            shapes = jax.eval_shape(partial(method.init, env), settings, drones, keys)
            shapes = placed(shapes, method.sharding, settings.num_envs)
            executor.submit(method.update.trace, env, settings, drones, shapes, keys, 0, 1)
        state, stages = (
            (start(()), ())
            if earlier is None
            else checkpoints.restored(earlier, start, fingerprint)
        )
        starts = starts_of(env, settings.episodes, drones)
    learners = placed(state.learners, method.sharding, settings.num_envs)
    return state._replace(learners=learners), stages, starts


@partial(jax.jit, static_argnums=(0, 1), compiler_options=compiler.once())
def _init_once(
    init: Wrapped, env: Environment, settings: Settings, drones: Distribution, keys: Array
) -> Any:
    """What a method begins with; JAX takes options of the compiler for an outermost `jit` alone."""
    return init(env, settings, drones, keys)


def _extended(state: _State, checkpoint: Checkpoint | None) -> _State:
    """The state of training before a further stage: named policies' earlier scores no longer count.

    Their task may be another.
    """
    count = len(state.going)
    if checkpoint is None or checkpoint.members is None:
        return state._replace(going=np.ones(count, bool))
    going = np.isin(np.arange(count), checkpoint.members)
    forgotten = (np.where(going, np.float32(-np.inf), best) for best in state.best_score)
    return state._replace(going=going, best_score=Evaluation(*forgotten))


def _updates_of_all(scores: Evaluation, ends: Sequence[int]) -> int:
    """Updates until an evaluation, of all policies together."""
    trained = np.isfinite(scores.survival[: len(ends)]).sum(axis=1)
    return int(np.diff([0, *ends]) @ trained)


def _of_members(going: np.ndarray, stacked: Any) -> Any:
    """What belongs to policies that are trained, of arrays with a first axis of all policies."""
    return stacked if going.all() else _pick(tuple(np.flatnonzero(going).tolist()), stacked)


@partial(jax.jit, static_argnums=0)
def _pick(members: tuple[int, ...], stacked: Any) -> Any:
    return tree.map(lambda leaf: leaf[np.array(members)], stacked)


@partial(jax.jit, static_argnums=0)
def _put(members: tuple[int, ...], stacked: Any, some: Any) -> Any:
    return tree.map(lambda old, new: old.at[np.array(members)].set(new), stacked, some)


def _advanced(state: _State, learners: Any, scores: Evaluation) -> _State:
    """The state after one more evaluation; of each policy the better one counts."""
    # By NumPy: JAX would compile a program for each operation and shape.
    scores, policy = tree.map(np.asarray, (scores, learners.policy))

    def among_all(old: Any, new: np.ndarray) -> np.ndarray:
        every = np.array(old, new.dtype)
        every[state.going] = new
        return every

    def chosen(where: np.ndarray, new: np.ndarray, old: np.ndarray) -> np.ndarray:
        return np.where(where.reshape(-1, *[1] * (old.ndim - 1)), new, old)

    unknown = Evaluation(*(np.full_like(best, np.nan) for best in state.best_score))
    scores, policy = tree.map(among_all, (unknown, state.best), (scores, policy))
    if not state.going.all():
        learners = _put(tuple(np.flatnonzero(state.going).tolist()), state.learners, learners)
    better = partial(chosen, scores.beats(state.best_score))
    now = partial(chosen, np.arange(len(state.scores.survival)) == state.scored)
    return _State(
        learners,
        best=tree.map(better, policy, state.best),
        best_score=tree.map(better, scores, state.best_score),
        scores=tree.map(now, scores, state.scores),
        scored=np.int32(state.scored + 1),
        going=state.going,
    )


def _compiling_scores(
    env: Environment, settings: Settings, policies: Policy, starts: Starts
) -> Thread:
    """Compiles `evaluate_together` on another core: compiling takes most of a short training."""

    def compiled() -> None:
        # What fails here fails in the training too, which says it.
        with suppress(Exception):
            evaluate_together.lower(env, settings.num_envs, policies, starts).compile()

    thread = Thread(target=compiled, daemon=True)
    thread.start()
    return thread
