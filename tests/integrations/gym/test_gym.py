"""Gymnasium's own checks pass; a seed is an episode; many drones fly as each does alone."""

import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="needs pip install '.[gym]'")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402

import maidenflight.integrations.gym  # noqa: E402
from maidenflight import parameters  # noqa: E402
from maidenflight.errors import InputError  # noqa: E402
from maidenflight.integrations.gym import arguments, rewards  # noqa: E402
from maidenflight.parameters import crazyflie, noiseless, replace  # noqa: E402
from maidenflight.simulator.physics import dynamics  # noqa: E402
from maidenflight.simulator.policy_spec import PolicySpec  # noqa: E402
from maidenflight.simulator.randomization import relative_box  # noqa: E402
from maidenflight.simulator.tasks import tasks, waypoints  # noqa: E402
from maidenflight.simulator.tasks.look_ahead import LookAhead  # noqa: E402

IDS = [f"maidenflight/{name}-v0" for name in maidenflight.integrations.gym.TASKS]
CIRCLE = "maidenflight/Circle-v0"
QUIET = noiseless(crazyflie())
HOVER = np.full(4, 2 / 1.725 - 1, np.float32)
SHORT = {"trajectory": "circle", "farthest": 1e3, "duration": 0.3, "parameters": QUIET}
"""A task that nothing but time ends, of 30 steps."""


def world(task="circle", control="pwm", parameters=None, **options):
    return arguments.world(task, control, parameters, "2026.08", PolicySpec(), "task", options)


def actions(count, seed=0, shape=(4,)):
    return np.random.default_rng(seed).uniform(-0.5, 0.8, (count, *shape)).astype(np.float32)


def flown(environment, steps, seed=None):
    """First observation and what every step gave, on through the episodes."""
    observation, info = environment.reset(seed=seed)
    given = [observation]
    for action in actions(steps):
        observation, reward, terminated, truncated, info = environment.step(action)
        given.append(
            np.array(
                [*observation, reward, terminated, truncated, *([info["duration"]] if info else [])]
            )
        )
        if terminated or truncated:
            given.append(environment.reset()[0])
    return given


def same(one, other):
    return len(one) == len(other) and all(
        np.array_equal(a, b) for a, b in zip(one, other, strict=True)
    )


@pytest.mark.parametrize(
    ("name", "control"),
    [
        *(
            pytest.param(
                name, "pwm", marks=pytest.mark.slow if name == CIRCLE else pytest.mark.night
            )
            for name in IDS
        ),
        pytest.param(CIRCLE, "attitude_rate", marks=pytest.mark.slow),
    ],
)
def test_gymnasiums_own_check_passes_without_a_warning(name, control):
    environment = gymnasium.make(name, control=control, render_mode="rgb_array").unwrapped
    check_env(environment)
    observation, _ = environment.reset(seed=0)
    assert observation.shape == (40,)
    assert observation.dtype == np.float32
    assert environment.metadata["render_fps"] == {"pwm": 100, "attitude_rate": 50}[control]


@pytest.mark.slow
def test_the_same_seed_is_the_same_episodes_in_every_instance():
    one, other = gymnasium.make(CIRCLE), gymnasium.make(CIRCLE)
    first = flown(one, 150, seed=3)
    assert sum(len(step) == 40 for step in first) > 2, "several episodes were flown"
    assert same(first, flown(other, 150, seed=3))
    assert same(first, flown(one, 150, seed=3))
    assert not np.allclose(first[0], flown(one, 1, seed=4)[0], atol=1e-3)


def test_without_a_seed_the_next_episode_of_the_same_seed_begins():
    environment = gymnasium.make(CIRCLE)
    starts = [environment.reset(seed=5)[0]] + [environment.reset()[0] for _ in range(70)]
    assert len(np.unique(starts, axis=0)) == 71, "also beyond those that were prepared"
    again = [environment.reset(seed=5)[0]] + [environment.reset()[0] for _ in range(70)]
    np.testing.assert_array_equal(starts, again)


@pytest.mark.slow
def test_a_look_ahead_is_seen_by_one_drone_and_by_many():
    given = {"spec": PolicySpec(look_ahead=LookAhead(2, 0.5)), "parameters": QUIET}
    alone, many = gymnasium.make(CIRCLE, **given), gymnasium.make_vec(CIRCLE, num_envs=2, **given)
    assert alone.observation_space.shape == many.single_observation_space.shape == (46,)
    first, both = alone.reset(seed=3)[0], many.reset(seed=3)[0]
    np.testing.assert_array_equal(both[0], first)
    for seen in (first, alone.step(HOVER)[0]):
        # Half a second is a sixth of the circle about (0.25, 0, 1), clock-wise.
        setpoint = seen[33:36] + seen[20:23] - [0.25, 0.0, 1.0]
        for number in (1, 2):
            cosine, sine = np.cos(np.pi / 3 * number), np.sin(np.pi / 3 * number)
            x, y, z = setpoint
            later = [cosine * x + sine * y + 0.25, cosine * y - sine * x, z + 1.0]
            ahead = seen[40:].reshape(2, 3)[number - 1]
            np.testing.assert_allclose(ahead, later - seen[20:23], atol=1e-5)


def test_environments_that_were_never_seeded_differ():
    one, other = gymnasium.make(CIRCLE), gymnasium.make(CIRCLE)
    assert not np.allclose(one.reset()[0], other.reset()[0], atol=1e-4)


def test_what_a_step_gave_is_ones_own_to_change():
    environment = gymnasium.make(CIRCLE)
    first, _ = environment.reset(seed=0)
    first[:] = 0.0
    kept, *_ = environment.step(HOVER)
    before = kept.copy()
    environment.step(HOVER)
    np.testing.assert_array_equal(kept, before)
    kept[:] = 0.0


@pytest.mark.slow
def test_time_up_is_truncation_and_the_statistics_are_those_of_the_flight():
    environment = gymnasium.make("maidenflight/Tracking-v0", **SHORT)
    environment.reset(seed=0)
    errors, info = [], {}
    for number in range(30):
        observation, _, terminated, truncated, info = environment.step(HOVER)
        errors.append(np.linalg.norm(observation[-7:-4]))
        assert not terminated
        assert truncated is (number == 29)
        assert bool(info) is truncated
    assert info["end_reason"] == "time limit"
    np.testing.assert_allclose(info["position_error"], np.mean(errors), rtol=1e-4)
    np.testing.assert_allclose(info["duration"], 0.3, rtol=1e-4)


def test_failure_is_termination_and_says_why():
    environment = gymnasium.make(CIRCLE)
    environment.reset(seed=0)
    count, (reward, terminated, truncated, info) = 0, (0.0, False, False, {})
    while not (terminated or truncated):
        count, (_, reward, terminated, truncated, info) = count + 1, environment.step(-np.ones(4))
    assert info["end_reason"] == "position error"
    assert reward < -50
    assert not truncated
    assert abs(info["duration"] - 0.01 * count) < 0.0011 * count, (
        "the time step is randomized by up to 10 %"
    )


@pytest.mark.slow
@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_an_action_that_is_no_number_is_told(make):
    environment = make(CIRCLE, **({} if make is gymnasium.make else {"num_envs": 3}))
    environment.reset(seed=0)
    with pytest.raises(InputError, match="finite"):
        environment.step(np.full(environment.action_space.shape, np.nan, np.float32))


def test_many_drones_fly_as_each_does_alone_with_its_seed():
    """Against Gymnasium's own vector environment, through several ends and new beginnings."""
    ours, theirs = (
        gymnasium.make_vec(CIRCLE, num_envs=3),
        gymnasium.make_vec(CIRCLE, num_envs=3, vectorization_mode="sync"),
    )
    assert type(ours).__name__ == "QuadrotorVectorEnv"
    assert (
        ours.metadata["autoreset_mode"]
        is theirs.metadata["autoreset_mode"]
        is AutoresetMode.NEXT_STEP
    )
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    np.testing.assert_allclose(ours.reset(seed=7)[0], theirs.reset(seed=7)[0], atol=1e-6)
    ends = np.zeros(3, int)
    for action in actions(150, shape=(3, 4)):
        one, other = ours.step(action), theirs.step(action)
        np.testing.assert_allclose(one[0], other[0], rtol=1e-3, atol=2e-3)
        np.testing.assert_allclose(one[1], other[1], rtol=1e-3, atol=1e-3)
        for a, b in zip(one[1:4], other[1:4], strict=True):
            assert a.dtype == b.dtype
        np.testing.assert_array_equal(one[2], other[2])
        np.testing.assert_array_equal(one[3], other[3])
        assert one[4].keys() == other[4].keys()
        if one[4]:
            assert list(one[4]["end_reason"]) == list(other[4]["end_reason"])
            np.testing.assert_allclose(one[4]["duration"], other[4]["duration"], rtol=1e-4)
        ends += one[2] | one[3]
    assert np.all(ends >= 2)


@pytest.mark.slow
def test_the_step_after_an_end_begins_the_next_episode_and_nothing_else():
    drones = gymnasium.make_vec("maidenflight/Tracking-v0", num_envs=2, **SHORT)
    drones.reset(seed=[1, 2])
    last = [drones.step(np.stack([HOVER, HOVER])) for _ in range(30)][-1]
    assert last[3].all()
    assert list(last[4]["end_reason"]) == ["time limit"] * 2
    first, rewards, terminated, truncated, info = drones.step(np.ones((2, 4)))
    alone = gymnasium.make("maidenflight/Tracking-v0", **SHORT)
    alone.reset(seed=2)
    np.testing.assert_allclose(first[1], alone.reset()[0], atol=1e-6)
    np.testing.assert_array_equal(rewards, 0.0)
    assert not terminated.any()
    assert not truncated.any()
    assert info == {}
    np.testing.assert_array_equal(first[:, -4:], first[:, 16:20])


def test_many_drones_go_on_without_a_seed_and_repeat_with_it():
    drones = gymnasium.make_vec(CIRCLE, num_envs=3)
    first, second = drones.reset(seed=1)[0], drones.reset()[0]
    assert not np.allclose(first, second, atol=1e-3)
    np.testing.assert_array_equal(drones.reset(seed=[1, 2, 3])[0], first)
    np.testing.assert_array_equal(drones.reset()[0], second)


def test_the_picture_shows_the_drone_where_it_is():
    environment = gymnasium.make(CIRCLE, render_mode="rgb_array")
    environment.reset(seed=0)
    before = environment.render()
    assert before.shape == (480, 640, 3)
    assert before.dtype == np.uint8
    np.testing.assert_array_equal(environment.render(), before)
    for _ in range(22):
        environment.step(-np.ones(4))
    after = environment.render()
    rows = [
        np.flatnonzero((picture < 90).all(axis=2).any(axis=1)[60:]).mean()
        for picture in (before, after)
    ]
    assert rows[1] > rows[0] + 10, "motors off: the dark body went down"
    assert gymnasium.make(CIRCLE).unwrapped.render() is None


def test_every_drone_has_its_picture():
    drones = gymnasium.make_vec(CIRCLE, num_envs=3, render_mode="rgb_array")
    drones.reset(seed=0)
    pictures = drones.render()
    assert [picture.shape for picture in pictures] == [(480, 640, 3)] * 3
    assert not np.array_equal(pictures[0], pictures[1])


def test_drones_are_drawn_from_a_box_unless_one_is_named(tmp_path):
    env, drones = world(control="attitude_rate")
    assert str(drones) == str(relative_box(replace(crazyflie(), time_step=0.002)))
    assert env.steps_per_command == 1
    file = parameters.write_drone(tmp_path / "mine.toml", replace(crazyflie(), mass=0.031))
    for given in ("crazyflie", str(file), file, replace(crazyflie(), mass=0.031)):
        assert str(world(parameters=given)[1]) == ""
    box = relative_box(crazyflie(), 0.3)
    assert world(parameters=box)[1] is box


def test_the_shaped_reward_pays_for_every_period_that_is_flown():
    task = tasks.circle()
    reward = rewards.shaped(task).reward
    assert rewards.shaped(task) is rewards.shaped(task)
    setpoint, still = jnp.array([0.0, 0.0, 1.0]), jnp.zeros(4)

    def at(distance, rate=0.0, change=0.0):
        state = dynamics.at_hover(setpoint + jnp.array([distance, 0.0, 0.0]), QUIET)
        state = state._replace(body_rates=jnp.array([0.0, rate, 0.0]))
        return float(reward(state, setpoint, still.at[0].set(change), still))

    values = [at(0.0), at(0.1), at(0.1, rate=10.0), at(0.1, change=2.0), at(0.24, rate=100.0)]
    np.testing.assert_allclose(values, [1.0, 0.5, 0.4, 0.46, 0.0], atol=1e-6)
    assert at(0.26) == 0.0, "a failure"
    far = dynamics.at_hover(setpoint + jnp.array([0.2, 0.0, 0.0]), QUIET)
    periods = task.duration * 100
    own = float(task.reward(far, setpoint, still, still)) * periods
    assert own < -99.0, "with the task's own reward to fly badly costs as much as to fall at once"


@pytest.mark.slow
@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_an_environment_gives_the_shaped_reward(make):
    environment = make(CIRCLE, reward="shaped", parameters=QUIET)
    environment.reset(seed=0)
    action = HOVER if make is gymnasium.make else HOVER[None]
    given = [float(np.squeeze(environment.step(action)[1])) for _ in range(5)]
    assert all(0.3 < reward < 1.0 for reward in given)


def test_equal_environments_share_their_compiled_functions():
    one, other = (gymnasium.make(CIRCLE, height=1).unwrapped for _ in range(2))
    assert one.program is other.program


def test_way_points_of_a_file_are_a_task(tmp_path):
    (tmp_path / "way.csv").write_text("time,x,y,z\n0,0,0,1\n2,0.5,0,1\n3.5,0.5,0.5,1\n")
    task = world("tracking", waypoints=tmp_path / "way.csv")[0].task
    assert task.duration == 3.5
    np.testing.assert_allclose(task.reference(jnp.float32(1.0)), [0.25, 0, 1], atol=1e-6)
    curve = waypoints.pentagram()
    assert world("tracking", trajectory=curve)[0].task.reference is curve


@pytest.mark.parametrize(
    ("name", "given", "says"),
    [
        ("Circle", {"control": "thrust"}, "Give one of pwm, attitude_rate, attitude"),
        ("Circle", {"control": "attitude", "firmware": "2020.01"}, "Give one of 2021.10, 2026.08"),
        ("Circle", {"control": "attitude", "parameters": crazyflie()}, "time_step=0.002"),
        ("Circle", {"parameters": "no.toml"}, "give a TOML file or one of: crazyflie"),
        ("Circle", {"parameters": 0.028}, "Give Parameters"),
        ("Circle", {"spec": 2}, "expected such as PolicySpec(history=2)"),
        ("Circle", {"reward": "dense"}, "reward = 'dense'; expected 'task' or 'shaped'"),
        ("Circle", {"spec": PolicySpec(memory=4)}, "memory = 4, which a learner's own network"),
        ("Circle", {"spec": PolicySpec(form="raptor")}, "form = raptor, which a learner's own"),
        ("Circle", {"diameter": "wide"}, "expected a number"),
        ("Circle", {"period": -1}, "expected a number"),
        ("Circle", {"radius": 0.5}, "It has diameter, period, height"),
        ("Hover", {"height": float("inf")}, "expected a number"),
        ("Tracking", {"trajectory": "spiral"}, "Give one of circle, figure_eight, pentagram"),
        ("Tracking", {"trajectory": 3}, "a function of time"),
        ("Tracking", {"waypoints": "no.csv"}, "not a readable CSV file"),
        ("Tracking", {"duration": 0.0}, "expected a number"),
    ],
)
def test_a_wrong_argument_is_told_in_one_line(name, given, says):
    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(InputError) as caught:
            make(f"maidenflight/{name}-v0", **given)
        assert says in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_step_out_of_order_or_of_the_wrong_shape_is_told():
    alone, many = gymnasium.make(CIRCLE).unwrapped, gymnasium.make_vec(CIRCLE, num_envs=3)
    for environment, wrong in ((alone, np.zeros(3)), (many, np.zeros(4))):
        with pytest.raises(InputError, match="Call reset"):
            environment.step(np.zeros(environment.action_space.shape))
        environment.reset(seed=0)
        with pytest.raises(InputError, match="expected"):
            environment.step(wrong)
    with pytest.raises(InputError, match="3 drones"):
        many.reset(seed=[1, 2])
    with pytest.raises(InputError, match="1 or more"):
        gymnasium.make_vec(CIRCLE, num_envs=0)
    with pytest.raises(InputError, match="rgb_array"):
        gymnasium.make_vec(CIRCLE, num_envs=1, render_mode="human")


def run(code, *paths):
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={"PYTHONPATH": ":".join(map(str, paths))},
    )


@pytest.mark.slow
def test_importing_the_package_or_naming_it_registers_the_environments_without_jax():
    code = (
        f"import sys, maidenflight.integrations.gym, gymnasium; assert set({IDS}) <= "
        "gymnasium.registry.keys(); assert 'jax' not in sys.modules"
    )
    for lines in (
        code,
        "import gymnasium; gymnasium.make('maidenflight.integrations.gym:maidenflight/Circle-v0')",
    ):
        done = run(lines, Path(maidenflight.__file__).parents[1])
        assert (done.returncode, done.stderr) == (0, "")
    maidenflight.integrations.gym.register()


def test_without_gymnasium_one_line_says_what_to_install():
    missing = run(
        "import sys; sys.modules['gymnasium'] = None; import maidenflight.integrations.gym",
        Path(maidenflight.__file__).parents[1],
    )
    assert missing.stderr.splitlines()[-1].endswith("pip install -e '.[gym]'")
