"""What policies are trained with by default."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import pytest

from maidenflight import policy_file
from maidenflight.deployment.check import check_export
from maidenflight.identification.drone_file import DroneFile
from maidenflight.names import TRACKING
from maidenflight.parameters import crazyflie, replace
from maidenflight.policy import untrained_policy
from maidenflight.registry import EXPORTERS
from maidenflight.simulator.controllers import control
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks import tasks
from maidenflight.training import defaults
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.settings import PPO, Settings
from maidenflight.verbs.train import Train


def chosen(**settings: Any) -> tuple[Settings, PolicySpec]:
    """What a training of these settings has: the method's settings, and what policies see."""
    train = Train(**settings)
    return train.learner_settings, train.spec


@pytest.mark.parametrize("structure", control.CONTROLLERS)
@pytest.mark.parametrize("method", ["gradient", "ppo"])
@pytest.mark.slow
def test_the_usual_network_of_every_structure_can_be_exported_to_everything(
    structure: str, method: str
) -> None:
    for task in tasks.TASKS:
        _, spec = chosen(control=structure, task=task, method=method)
        ahead = {"authors"} if task == TRACKING else set()
        for to in set(EXPORTERS.own) - {"raptor", "px4"} - ahead:
            check_export(to, control.CONTROLLERS[structure]().interface, spec, crazyflie())


def test_attitude_control_is_trained_about_hovering_unless_the_papers_scales_are_asked_for() -> (
    None
):
    """A drone that hovers below 7/12 of full thrust cannot descend with the paper's."""
    drone = replace(crazyflie(), thrust_to_weight=2.5)
    counts = DroneFile(drone).full_scale_counts
    hovers = float(dynamics.hover_command(drone))
    made = defaults.choose_controller("attitude", drone, counts).interface
    least, most = (made.centre[0] + sign * made.span[0] for sign in (-1, 1))
    assert least < hovers - 0.2
    assert most > hovers + 0.2
    alike = replace(crazyflie(), thrust_to_weight=2.51)
    assert defaults.choose_controller("attitude", alike, counts).interface == made
    papers = defaults.choose_controller("attitude", drone, counts, paper_scales=True).interface
    assert papers == control.attitude().interface
    start = untrained_policy(jax.random.key(0), interface=papers)
    assert defaults.choose_controller("attitude", drone, counts, start).interface == papers
    for structure in control.CONTROLLERS:  # which training then refuses
        other = control.CONTROLLERS[structure](full_scale_counts=65535).interface
        start = untrained_policy(jax.random.key(0), interface=other)
        assert defaults.choose_controller(structure, drone, counts, start).interface != other
    assert (
        defaults.choose_controller("pwm", drone, counts).interface
        == control.pwm(full_scale_counts=counts).interface
    )


def test_pwm_reaches_beyond_full_scale_where_a_weak_drone_needs_it_and_its_battery_has_it() -> None:
    weak, usual = (replace(crazyflie(), thrust_to_weight=ratio) for ratio in (1.1, 1.49))
    most = {
        (drone is weak, counts): 2.0 * choose("pwm", drone, counts).interface.span[0]
        for choose in [defaults.choose_controller]
        for drone in (weak, usual)
        for counts in (60000.0, 65535.0)
    }
    ones = {(True, 60000.0): 1.0, (False, 60000.0): 1.0, (False, 65535.0): 1.0}
    assert most == pytest.approx(ones | {(True, 65535.0): 1.35})


def test_attitude_rate_fits_a_crazyflie_with_four_instants() -> None:
    _, spec = chosen(control="attitude_rate", history=4)
    assert (spec.history, spec.hidden) == (4, (75, 75))
    check_export("crazyflie", control.attitude_rate().interface, spec, crazyflie())


@pytest.mark.parametrize("structure", control.CONTROLLERS)
def test_gradients_see_most_of_a_second_ahead_and_with_a_memory_no_less(structure: str) -> None:
    rate = control.CONTROLLERS[structure]().interface.rate
    usual, remembering = (
        chosen(control=structure, method="gradient", memory=size)[0] for size in (0, 16)
    )
    assert isinstance(usual, AnalyticGradient)
    assert isinstance(remembering, AnalyticGradient)
    assert 0.6 < usual.horizon / rate < 0.85
    assert remembering.horizon / rate > 0.6
    assert remembering.updates >= usual.updates
    limits = (usual.largest_gradient, remembering.largest_gradient)
    assert limits == (float(structure != "pwm"), 0.0)


def test_a_memory_is_trained_with_its_own_settings(tmp_path: Path) -> None:
    usual, own = (chosen(method="gradient", memory=size)[0] for size in (0, 16))
    assert isinstance(usual, AnalyticGradient)
    assert isinstance(own, AnalyticGradient)
    assert own.hidden_learning_rate < usual.hidden_learning_rate
    assert own.updates == usual.updates
    assert chosen(method="ppo-paper")[0] == PPO.paper()
    alone = vars(chosen(method="gradient-paper")[0])
    costs = {name for name in alone if name.endswith("penalty")}
    assert alone == vars(usual) | dict.fromkeys(costs, 0.0)
    assert len(costs) == 6
    assert chosen(method="ppo", memory=16) == (PPO(), PolicySpec(memory=16))
    start = untrained_policy(jax.random.key(0), spec=PolicySpec(memory=16, hidden=(24, 12)))
    tuned, spec = chosen(initial=policy_file.write_policy(tmp_path / "start.json", start))
    assert isinstance(tuned, AnalyticGradient)
    assert (spec, tuned.num_envs) == (start.spec, own.num_envs)
    assert tuned.learning_rate < own.learning_rate
    raptor, spec = chosen(method="gradient", form="raptor")
    assert raptor == dataclasses.replace(own, learning_rate=2e-3)
    assert (spec, spec.hidden) == (PolicySpec(form="raptor"), (16,))
    assert tuned.updates < own.updates
