from dataclasses import replace as changed
from typing import Any

import jax
import pytest

from maidenflight.errors import InputError
from maidenflight.parameters import crazyflie, replace
from maidenflight.policy import untrained_policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.position_pid import position_pid
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import ensemble, relative_box
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.look_ahead import LookAhead
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.settings import PPO
from maidenflight.training.train import train
from maidenflight.training.training_spec import TrainingSpec, validate

BOX = relative_box(crazyflie(), 0.10)
KEYS = jax.random.split(jax.random.key(5), 2)
INITIAL = untrained_policy(KEYS[0], spec=PolicySpec(history=3, memory=4, hidden=(8,)))


USUAL: dict[str, Any] = {
    "task": tasks.circle(),
    "controller": control.pwm(),
    "distribution": BOX,
    "keys": KEYS,
    "settings": AnalyticGradient(updates=4, num_envs=4, horizon=4, evaluations=4, episodes=4),
    "policy": PolicySpec(hidden=(8,)),
}


def asked(**others: Any) -> TrainingSpec:
    return validate(**USUAL | others)


@pytest.mark.parametrize(
    ("distribution", "words"),
    [
        ([BOX], "1 distributions of drones for 2 keys"),
        ([BOX, "crazyflie"], "str is no distribution"),
        ([BOX, ensemble([BOX.centre])], "different kinds or sizes .Ensemble, RelativeBox"),
        (
            [BOX, relative_box(replace(BOX.centre, time_step=BOX.centre.time_step / 2))],
            "different frames or time steps",
        ),
    ],
)
def test_distributions_that_cannot_be_trained_over_together_are_refused(
    distribution: Any, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        train(**USUAL | {"distribution": distribution})


@pytest.mark.parametrize(
    ("others", "words"),
    [
        ({"task": tasks.circle}, r"is no Task; expected what mf\.simulator\.circle\(\) gives"),
        (
            {"controller": "pwm"},
            r"pwm is no Controller; expected what mf\.simulator\.pwm\(\) gives",
        ),
        ({"controller": position_pid()}, "position_pid cannot be trained for"),
        ({"distribution": crazyflie()}, "Parameters is no distribution of drones"),
        ({"keys": jax.random.key(0)}, "keys must be random keys, one a policy"),
        ({"keys": 0}, "keys must be random keys, one a policy"),
        ({"policy": 3}, r"3 is no PolicySpec or Policy; expected what mf\.PolicySpec\(\) gives"),
        ({"policy": PolicySpec(form="raptor"), "settings": PPO()}, "not by ppo"),
        ({"policy": INITIAL, "controller": control.attitude()}, "control structure"),
        ({"policy": INITIAL, "settings": PPO()}, "by gradients"),
        (
            {"task": tasks.circle()._replace(reward=lambda state, goal, *actions: goal.position)},
            "the reward of task circle is not a function that JAX can trace: AttributeError",
        ),
        (
            {"task": tasks.circle()._replace(reward=lambda state, goal, *actions: goal)},
            r"the reward of task circle has shape \(3,\); expected a number",
        ),
    ],
)
def test_what_cannot_be_trained_is_refused(others: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        train(**USUAL | others)


def test_what_policies_see_and_remember_is_as_asked_or_that_of_where_they_come_from() -> None:
    ahead = LookAhead(2, 0.2)
    spec = PolicySpec(history=3, look_ahead=ahead, memory=4)
    assert asked(policy=spec).env.spec == spec
    assert asked(policy=INITIAL).env.spec == INITIAL.spec


def test_more_updates_are_the_same_training_and_all_else_is_another() -> None:
    usual, settings = asked().fingerprint(), USUAL["settings"]
    assert asked().fingerprint() == usual
    assert asked(settings=changed(settings, updates=9)).fingerprint() == usual
    assert asked(distribution=[BOX, BOX]).fingerprint() == usual
    others = [
        {"task": tasks.hover()},
        {"controller": control.pwm(50)},
        {"distribution": relative_box(crazyflie(), 0.11)},
        {"distribution": [BOX, relative_box(crazyflie(), 0.11)]},
        {"keys": KEYS[::-1]},
        {"settings": changed(settings, tilt_penalty=3.0)},
        {"settings": PPO()},
        {"policy": PolicySpec(history=3, hidden=(8,))},
        {"policy": PolicySpec(look_ahead=LookAhead(2, 0.2), hidden=(8,))},
        {"policy": PolicySpec(look_ahead=LookAhead(2, 0.1), hidden=(8,))},
        {"policy": PolicySpec(memory=4, hidden=(8,))},
        {"policy": PolicySpec(hidden=(9,))},
        {"policy": PolicySpec(form="raptor")},
        {"policy": INITIAL},
    ]
    found = {asked(**other).fingerprint() for other in others}
    assert len(found | {usual}) == len(others) + 1


def test_drones_are_simulated_in_steps_that_divide_the_controllers_period():
    made = asked(controller=control.attitude_rate())
    assert made.drones.centre.time_step == pytest.approx([0.002, 0.002])
    assert made.env.steps_per_command == 1
    first = jax.tree.map(lambda leaf: leaf[0], made.drones)
    assert first.draw(KEYS[0]).time_step == pytest.approx(0.002)
    assert asked().drones.centre.time_step == pytest.approx([0.005, 0.005]), "as they are"
