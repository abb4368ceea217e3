import errno
import os
import socket
import subprocess
import sys
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import click
import jax
import jax.numpy as jnp
import numpy as np
import one_of_many
import pytest
from one_of_many import BOX, SPEC, TINY

from maidenflight import cli, policy, policy_file, results
from maidenflight.cli import command, interruption
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import transfer
from maidenflight.parameters import crazyflie, replace
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.randomization import relative_box, stacked
from maidenflight.simulator.realities.virtual_drone import virtual_drone
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.look_ahead import LookAhead
from maidenflight.training import analytic_gradient, defaults
from maidenflight.training import checkpoint as checkpoints
from maidenflight.training import train as module
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.checkpoint import Checkpoint
from maidenflight.training.evaluation import Evaluation, evaluate
from maidenflight.training.train import Progress, train
from maidenflight.verbs.train import Train

SMALL = AnalyticGradient(updates=150, num_envs=16, horizon=64, evaluations=3, episodes=32)
TASK, CONTROLLER = tasks.circle(), control.pwm()
"""The same objects in every test, so that training is compiled once a file."""
KEYS = jax.random.split(jax.random.key(5), 2)
ONE = Train(drone="crazyflie", policies=1, updates=600, randomize=0.1)


@pytest.fixture(autouse=True)
def no_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Final flights are tested elsewhere."""
    monkeypatch.setattr("maidenflight.training.final_flights.fly_drones", lambda *_: [])


def learn(
    saved: Path | None = None, hear: Any = None, settings: AnalyticGradient = TINY, box: Any = BOX
) -> tuple[Policy, ...]:
    spec = PolicySpec() if settings is SMALL else SPEC
    return train(TASK, CONTROLLER, box, KEYS, settings, spec, on_progress=hear, checkpoint=saved)


def assert_same(one: Any, other: Any) -> None:
    for left, right in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(left, right)


@pytest.fixture(scope="module")
def trained() -> tuple[tuple[Policy, ...], list[Progress]]:
    heard: list[Progress] = []
    return learn(hear=heard.append), heard


@pytest.fixture(scope="module")
def flying() -> tuple[tuple[Policy, ...], list[Progress]]:
    heard: list[Progress] = []
    return learn(hear=heard.append, settings=SMALL), heard


def test_training_tells_how_far_it_is_and_is_the_same_in_stretches(trained: Any) -> None:
    told: list[tuple[int, int]] = []
    policies = train(
        *(TASK, CONTROLLER, BOX, KEYS, TINY, SPEC),
        on_update=lambda done, of: told.append((done, of)),
    )
    assert_same(policies, trained[0])
    assert told[-1] == (TINY.updates, TINY.updates)
    assert [done for done, _ in told] == sorted({done for done, _ in told})
    assert len(told) >= TINY.evaluations


@pytest.mark.slow
def test_training_makes_policies_fly_that_did_not(flying: Any) -> None:
    policies, heard = flying
    env = Environment.matching(BOX.centre, TASK, CONTROLLER)
    before = evaluate(env, untrained_policy(jax.random.key(0)), BOX, jax.random.key(9), 32)
    after = [evaluate(env, policy, BOX, jax.random.key(9), 32) for policy in policies]
    assert float(before.survival) == 0.0
    assert all(float(score.survival) > 0.5 for score in after)
    assert [progress.update for progress in heard] == [50, 100, 150]
    assert heard[-1].steps == 150 * 16 * 64 * 2


def test_each_policy_is_trained_and_scored_over_the_drones_of_its_key(trained: Any) -> None:
    over_all, heard = trained
    scores: list[Progress] = []
    weak = replace(BOX.centre, thrust_to_weight=1.3)
    first, second = learn(hear=scores.append, box=[BOX, relative_box(weak, 0.10)])
    assert_same(first, over_all[0])
    # A weak drone hovers nearer to full thrust, which the last biases begin with.
    assert np.all(second.biases[-1] > over_all[1].biases[-1] + 0.1)
    for before, after in zip(heard, scores, strict=True):
        assert after.score.episode_return[0] == before.score.episode_return[0]
        assert after.score.episode_return[1] != before.score.episode_return[1]


@pytest.mark.slow
def test_the_best_scored_policy_is_kept_not_the_last(flying: Any) -> None:
    policies, heard = flying
    env = Environment.matching(BOX.centre, TASK, CONTROLLER)
    for number, one in enumerate(policies):
        ranked = [
            (
                round(20 * float(then.score.survival[number])),
                float(then.score.episode_return[number]),
            )
            for then in heard
        ]
        score = evaluate(env, one, BOX, jax.random.key(0), SMALL.episodes)
        np.testing.assert_allclose(float(score.episode_return), max(ranked)[1], rtol=1e-3)


def test_each_key_has_its_own_policy(trained: Any) -> None:
    policies, _ = trained
    assert not np.allclose(policies[0].weights[0], policies[1].weights[0])


@pytest.mark.slow
def test_training_from_a_policy_begins_with_its_score_and_ends_no_worse(
    trained: Any, tmp_path: Path
) -> None:
    initial, heard = trained[0][0], []
    asked: Any = (TASK, CONTROLLER, BOX, KEYS, TINY)
    saved = tmp_path / "training.npz"

    def tuned(hear: Any, from_: Policy = initial) -> tuple[Policy, ...]:
        return train(*asked, policy=from_, on_progress=hear, checkpoint=saved)

    def interrupt(progress: Progress) -> None:
        if progress.update == 2:
            raise KeyboardInterrupt

    policies = train(*asked, policy=initial, on_progress=heard.append)
    assert [(one.update, one.steps > 0) for one in heard] == [
        (number, number > 0) for number in range(5)
    ]
    env = Environment.matching(BOX.centre, TASK, CONTROLLER, spec=SPEC)
    before, *after = module.evaluate_together(
        env,
        TINY.num_envs,
        jax.tree.map(lambda *leaves: jnp.stack(leaves), initial, *policies),
        module.starts_of(env, TINY.episodes, stacked([BOX] * 3)),
    ).duration  # none survives
    np.testing.assert_allclose(heard[0].score.duration, before, rtol=1e-4)
    assert all(float(one) >= float(before) - 1e-4 for one in after)
    assert {policy.layer_sizes for policy in policies} == {(66, 8, 4)}
    with pytest.raises(KeyboardInterrupt):
        tuned(interrupt)
    assert_same(tuned(None), policies)
    with pytest.raises(InputError, match="another training"):
        tuned(None, trained[0][1])


@pytest.mark.slow
@pytest.mark.parametrize("heard_until", [0, 1, 2])
def test_interrupted_training_goes_on_to_the_same_policies_and_tells_its_whole_story(
    heard_until: int, trained: Any, tmp_path: Path
) -> None:
    saved, heard = tmp_path / "training.npz", []

    def interrupt(progress: Progress) -> None:
        if len(heard) == heard_until:
            raise KeyboardInterrupt
        heard.append(progress)

    with pytest.raises(KeyboardInterrupt):
        learn(saved, interrupt)
    heard.clear()
    policies = learn(saved, heard.append)
    assert_same(policies, trained[0])
    # What a checkpoint remembers of a score is not the policies of that time.
    assert_same(
        [one._replace(best=None) for one in heard], [one._replace(best=None) for one in trained[1]]
    )
    assert_same(learn(saved), policies)


@pytest.mark.parametrize(
    "other",
    [
        {"settings": changed(TINY, learning_rate=1e-3)},
        {"settings": changed(TINY, updates=5)},
        {"box": relative_box(crazyflie())},
    ],
)
def test_the_checkpoint_of_another_training_is_refused_and_kept(other: Any, tmp_path: Path) -> None:
    saved = tmp_path / "training.npz"

    def interrupt(_: Progress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        learn(saved, interrupt)
    before = saved.read_bytes()
    with pytest.raises(InputError, match="a checkpoint of another training"):
        learn(saved, **other)
    assert saved.read_bytes() == before


@pytest.mark.slow
def test_training_that_has_ended_is_extended_and_an_extension_is_resumed(tmp_path: Path) -> None:
    further = changed(TINY, updates=6)

    def extended(folder: str, hear: Any = None) -> tuple[Policy, ...]:
        saved = tmp_path / folder / "training.npz"
        if not saved.exists():
            learn(saved)
        return learn(saved, hear, further)

    def interrupt(progress: Progress) -> None:
        if progress.update == 5:
            raise KeyboardInterrupt

    heard: list[Progress] = []
    policies = extended("whole", heard.append)
    assert [progress.update for progress in heard] == [1, 2, 3, 4, 5, 6]
    assert [progress.steps for progress in heard] == [update * 32 for update in range(1, 7)]
    with pytest.raises(KeyboardInterrupt):
        extended("killed", interrupt)
    assert_same(extended("killed"), policies)
    whole, killed = (tmp_path / folder / "training.npz" for folder in ("whole", "killed"))
    assert whole.read_bytes() == killed.read_bytes()
    assert checkpoints.stages(whole) == (4, 6)
    with pytest.raises(InputError, match=r"updates was 6 and is 4\. Give 6, or more"):
        learn(whole)


@pytest.mark.night
def test_an_extension_of_one_policy_leaves_the_other_and_is_resumed(tmp_path: Path) -> None:
    """The one that goes on learns as it would beside the other, to rounding."""

    def extended(name: str, members: Any = None, hear: Any = None) -> tuple[Policy, ...]:
        saved = tmp_path / name
        if not saved.exists():
            learn(saved)
        return train(
            TASK,
            CONTROLLER,
            BOX,
            KEYS,
            changed(TINY, updates=6),
            SPEC,
            on_progress=hear,
            checkpoint=Checkpoint(saved, members=members),
        )

    def interrupt(progress: Progress) -> None:
        if progress.update == 5:
            raise KeyboardInterrupt

    heard: list[Progress] = []
    policies = extended("whole", [1], heard.append)
    survival = np.array([progress.score.survival for progress in heard])
    assert np.isnan(survival).tolist() == [[False] * 2] * 4 + [[True, False]] * 2
    assert [progress.steps for progress in heard] == [32, 64, 96, 128, 144, 160]
    with pytest.raises(KeyboardInterrupt):
        extended("killed", [1], interrupt)
    assert_same(extended("killed"), policies)
    both, ended = extended("both", [0, 1]), learn()
    assert_same(policies[0], ended[0])
    for one, other in zip(jax.tree.leaves(policies[1]), jax.tree.leaves(both[1]), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-4)
    # What it scored before was perhaps by another task, so that it is none of those it was then.
    assert not np.array_equal(*(some[1].network[0][0] for some in (policies, ended)))


def test_another_number_of_updates_or_another_weight_compiles_nothing_anew(trained: Any) -> None:
    def programs() -> int:
        compiled: list[Any] = [analytic_gradient.init, analytic_gradient.update]
        return sum(function._cache_size() for function in compiled)

    before = programs()
    learn(settings=changed(TINY, updates=2, evaluations=1, learning_rate=1e-3, tilt_penalty=0.5))
    assert programs() == before


@pytest.mark.slow
def test_an_extension_is_recorded(tmp_path: Path, monkeypatch: Any) -> None:
    made = policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(3,)))
    stub = training_that_gives(made)

    def extended(*arguments: Any, checkpoint: Checkpoint, **further: Any) -> tuple[Policy, ...]:
        given = stub(*arguments, checkpoint=checkpoint, **further)
        checkpoints.save(checkpoint.path, (), "", (600, 700))
        return given

    monkeypatch.setattr("maidenflight.training.train.train", stub)
    ONE.run(tmp_path)
    assert (
        "extended_from"
        not in policy_file.read_policy(tmp_path / "policy_1.json").record["settings"]
    )
    monkeypatch.setattr("maidenflight.training.train.train", extended)
    changed(ONE, updates=700, resume=True).run(tmp_path)
    settings = policy_file.read_policy(tmp_path / "policy_1.json").record["settings"]
    assert (settings["updates"], settings["extended_from"]) == (700, [600])
    changed(ONE, updates=None, resume=True).run(tmp_path)
    settings = policy_file.read_policy(tmp_path / "policy_1.json").record["settings"]
    assert settings["updates"] == 700, "unless given, those of the training that is resumed"


@pytest.mark.slow
def test_the_rates_of_further_updates_are_those_of_a_training_of_so_many() -> None:
    """Half of twice as many updates: 2 % and half of the other 98 % of the initial rate."""
    network: Any = untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(8,))).network
    gradient = jax.tree.map(jnp.ones_like, network)

    def change(updates: int, done: int) -> float:
        rule = analytic_gradient.optimiser_of(
            changed(TINY, updates=updates, hidden_learning_rate=0.0)
        )
        state: Any = jax.tree.map(
            lambda leaf: leaf + done if leaf.dtype == jnp.int32 else leaf, rule.init(network)
        )
        with jax.numpy_dtype_promotion("standard"):
            changes: Any = rule.update(gradient, state, network)[0]
        return float(changes[1][-1][0])

    ratio = change(20, 10) / change(10, 10)
    np.testing.assert_allclose(ratio, 0.51 / 0.02, rtol=1e-4)


@pytest.mark.slow
def test_a_full_disk_is_said_in_a_line_and_training_goes_on_when_there_is_space(
    tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    """By the command line; the disk is full when the second score is kept and, after resuming, when
    the second policy is written."""
    replace_ = os.replace
    monkeypatch.setitem(tasks.TASKS, "circle", lambda: TASK)
    monkeypatch.setitem(control.CONTROLLERS, "pwm", lambda **_: CONTROLLER)
    monkeypatch.setattr(defaults, "choose_settings", lambda *_: TINY)
    spec = "--history 3 --look-ahead 2 --look-ahead-spacing 0.2 --memory 4 --hidden 8".split()
    what = "maidenflight train --drone crazyflie --randomize 0.1 --policies 2".split()
    what += [*spec, "-o"]
    written: list[str] = []

    def command(folder: Path, *further: str, full_at: str = "", number: int = 1) -> tuple[int, str]:
        def put(source: Any, target: Any) -> None:
            written.append(Path(target).name)
            if written.count(full_at) == number:
                raise OSError(errno.ENOSPC, "No space left on device")
            replace_(source, target)

        written.clear()
        monkeypatch.setattr(sys, "argv", [*what, str(folder), *further])
        monkeypatch.setattr(os, "replace", put)
        try:
            cli.main()
            code = 0
        except SystemExit as leaving:
            code = int(leaving.code or 0)
        monkeypatch.setattr(os, "replace", replace_)
        return code, capsys.readouterr().err

    folder, whole = tmp_path / "stopped", tmp_path / "whole"
    code, err = command(folder, full_at="training.npz")
    *scores, err = err.splitlines(keepends=True)
    assert code == 2
    assert all(line.startswith("update ") for line in scores)
    assert "training.npz: cannot be written (No space left on device). Free space there" in err
    assert not list(folder.iterdir())

    kept: list[bytes] = []
    for further, full_at, number in (
        ((), "training.npz", 2),
        (("--resume",), "policy_2.json", 1),
        (("--resume",), "training.csv", 1),
    ):
        code, err = command(folder, *further, full_at=full_at, number=number)
        assert code == 2
        *scores, err = err.splitlines(keepends=True)
        assert all(line.startswith("update ") for line in scores)
        again = " ".join([*what, str(folder), "--resume"])
        assert f"{full_at}: cannot be written (No space left on device)." in err
        assert (
            f"training.npz holds what was reached. Free space there and go on with: {again}\n"
            in err
        )
        kept.append((folder / "training.npz").read_bytes())
    assert kept[0] != kept[1] == kept[2]
    assert command(folder, "--resume")[0] == command(whole)[0] == 0
    names = ["policy_1.json", "policy_2.json", "training.csv", "training.npz"]
    assert [sorted(path.name for path in place.iterdir()) for place in (folder, whole)] == [
        names,
        names,
    ]
    assert [(folder / name).read_bytes() for name in names] == [
        (whole / name).read_bytes() for name in names
    ]

    # Training that has ended is resumed to the same end.
    assert command(folder, "--resume")[0] == 0
    (folder / "training.npz").unlink()
    code, err = command(folder, "--resume")
    assert code == 2
    assert "no training to resume. The policies there are of a training whose state is gone." in err


def training_that_gives(*policies: Policy) -> Any:
    """In place of `train`: one evaluation, a checkpoint, and these policies."""

    def given(
        *arguments: Any, on_progress: Any, checkpoint: Checkpoint, **_: Any
    ) -> tuple[Policy, ...]:
        score = Evaluation(*(jnp.zeros(len(arguments[3])) for _ in Evaluation._fields))
        on_progress(Progress(arguments[4].updates, 1, score))
        checkpoints.save(checkpoint.path, (), "", (arguments[4].updates,))
        return policies

    return given


def test_what_a_killed_run_left_is_cleared_and_does_not_stand_in_the_way(
    tmp_path: Path, monkeypatch: Any
) -> None:
    """A run without --resume, for there is no checkpoint, into a folder that holds nothing but half
    a file."""
    left = tmp_path / ".training.npz.abcdefgh.part"
    left.write_bytes(b"half")
    with click.Context(click.Command("train")):
        command.claim(tmp_path, overwrite=False, resume=False)
    with pytest.raises(InputError, match=r"no training to resume\. Leave out --resume"):
        changed(ONE, resume=True).run(tmp_path)
    monkeypatch.setattr("maidenflight.training.train.train", training_that_gives())
    ONE.run(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["training.csv", "training.npz"]


def test_policies_of_an_earlier_training_of_more_go(tmp_path: Path, monkeypatch: Any) -> None:
    older = policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(3,)))
    for number in (1, 2, 3):
        policy_file.write_policy(tmp_path / f"policy_{number}.json", older, {"number": number})
    policy_file.write_policy(tmp_path / "policy_4.json", older, {"note": "put here by somebody"})
    (tmp_path / "policy_5.json").write_text("not a policy")
    monkeypatch.setattr("maidenflight.training.train.train", training_that_gives(older))
    changed(ONE, seed=7).run(tmp_path)
    assert sorted(path.name for path in tmp_path.glob("*.json")) == [
        "policy_1.json",
        "policy_4.json",
        "policy_5.json",
    ]
    assert policy_file.read_policy(tmp_path / "policy_1.json").record["seed"] == 7


def test_an_earlier_training_stays_until_the_first_checkpoint_of_the_one_in_its_place(
    tmp_path: Path, monkeypatch: Any
) -> None:
    def interrupted(*_: Any, checkpoint: Checkpoint, **__: Any) -> Any:
        assert checkpoint.restart
        raise KeyboardInterrupt

    monkeypatch.setattr(
        "maidenflight.training.train.train",
        training_that_gives(
            policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(3,)))
        ),
    )
    changed(ONE, seed=7).run(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    monkeypatch.setattr("maidenflight.training.train.train", interrupted)
    with pytest.raises(KeyboardInterrupt):
        changed(ONE, seed=8).run(tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_an_interrupted_command_says_whether_its_own_checkpoint_is_there(
    tmp_path: Path, monkeypatch: Any
) -> None:
    saved = tmp_path / "training.npz"
    saved.write_text("of an earlier training")
    for arguments, written, said in (
        (["train", "--overwrite"], False, "before anything was reached"),
        (["train", "--overwrite"], True, "--resume"),
        (["train", "--resume"], False, "--resume"),
    ):
        monkeypatch.setattr(sys, "argv", ["maidenflight", *arguments])
        with interruption.resumable(saved):
            if written:
                results.write(saved, "of this one")
            assert said in interruption.line()


def test_a_mistake_in_the_command_keeps_an_earlier_training(tmp_path: Path) -> None:
    (tmp_path / "training.npz").touch()
    with pytest.raises(InputError, match="no such drone"):
        changed(ONE, drone=str(tmp_path / "none.toml")).run(tmp_path)
    assert (tmp_path / "training.npz").exists()


def test_a_return_that_is_no_number_ends_training_and_keeps_what_was_good(
    monkeypatch: Any, tmp_path: Path
) -> None:
    scores, calls, saved = module.evaluate_together, [], tmp_path / "training.npz"

    def diverging(*arguments: Any) -> Any:
        calls.append(1)
        score = scores(*arguments)
        return (
            score
            if len(calls) == 1
            else score._replace(episode_return=jnp.full_like(score.episode_return, jnp.nan))
        )

    monkeypatch.setattr(diverging, "lower", scores.lower, raising=False)
    monkeypatch.setattr(module, "evaluate_together", diverging)
    kept: list[bytes] = []
    with pytest.raises(
        InputError,
        match=r"updates 1 and 2.*training\.npz holds .* at update 1\.",
    ):
        learn(saved, lambda _: kept.append(saved.read_bytes()))
    assert [saved.read_bytes()] == kept


@pytest.mark.night
def test_a_policy_of_raptors_form_learns_and_is_trained_further() -> None:
    heard: list[Progress] = []
    asked: Any = (TASK, CONTROLLER, BOX, KEYS[:1])
    (first,) = train(
        *asked, settings=SMALL, policy=PolicySpec(form="raptor"), on_progress=heard.append
    )
    assert (first.spec.form, first.layer_sizes) == ("raptor", (22, 16, 4))
    first.check()
    assert heard[-1].score.episode_return[0] > heard[0].score.episode_return[0] + 50.0
    flown = transfer(first, virtual_drone(7), 1, duration=0.5)
    assert np.isfinite(flown.table["position_error"][0])
    (further,) = train(*asked, settings=changed(SMALL, updates=1, evaluations=1), policy=first)
    assert further.spec.form == "raptor"


@pytest.mark.slow
def test_a_policy_sees_and_remembers_as_much_as_asked_and_else_it_is_another_training(
    tmp_path: Path,
) -> None:
    saved, settings = tmp_path / "training.npz", changed(TINY, updates=1, evaluations=1)
    for made in learn(saved, settings=settings):
        assert (made.spec, made.layer_sizes) == (SPEC, (66, 8, 4))
        made.check()
    for other, words in (
        ({"look_ahead": LookAhead()}, "look_ahead was {.*} and is null"),
        ({"look_ahead": LookAhead(2, 0.1)}, "look_ahead was "),
        ({"memory": 5}, "memory was 4 and is 5"),
        ({"memory": 0}, "memory was 4 and is null"),
        ({"history": 2}, "history was 3 and is 2"),
        ({"hidden": (9,)}, r"hidden was \[8\] and is \[9\]"),
    ):
        with pytest.raises(InputError, match=f"a checkpoint of another training: {words}"):
            train(
                *(TASK, CONTROLLER, BOX, KEYS, settings, changed(SPEC, **other)), checkpoint=saved
            )


def test_settings_of_no_method_are_refused() -> None:
    with pytest.raises(InputError, match="dict are not settings of a method"):
        train(tasks.circle(), control.pwm(), BOX, KEYS, {})  # type: ignore[arg-type]


@pytest.mark.night
@pytest.mark.parametrize("method", ["AnalyticGradient", "PPO"])
def test_two_processes_learn_what_one_does_and_share_its_checkpoint(
    method: str, tmp_path: Path
) -> None:
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]

    def begin(number: int) -> tuple[subprocess.Popen[str], Path]:
        to = tmp_path / f"process_{number}"
        to.mkdir()
        script = [sys.executable, one_of_many.__file__]
        arguments = [2, number, port, tmp_path, to, method]
        return subprocess.Popen(
            [*script, *map(str, arguments)],
            stderr=subprocess.PIPE,
            text=True,
        ), to

    started = [begin(0), begin(1)]
    learnt = one_of_many.learn(one_of_many.METHODS[method], tmp_path / "1.npz")
    one_of_many.save(learnt, tmp_path / "policies.npz")
    for process, _ in started:
        _, told = process.communicate(timeout=1200)
        assert process.returncode == 0, told
    alone, *together = (
        np.load(to / "policies.npz") for to in (tmp_path, *(to for _, to in started))
    )
    for found in together:
        for name in alone:
            # Sums over two devices round otherwise than over one, and training amplifies that.
            np.testing.assert_allclose(found[name], alone[name], atol=1e-3)
    one, two = (np.load(tmp_path / f"{count}.npz") for count in (1, 2))
    assert str(one["title"]) == str(two["title"])
    for name in set(one) - {"title"}:
        np.testing.assert_allclose(
            two[name].astype(float), one[name].astype(float), rtol=1e-3, atol=1e-3
        )


def test_training_that_changes_nothing_is_refused() -> None:
    before = {"weights": np.ones(3), "bias": np.zeros(2)}
    module._must_have_learned(before, before | {"bias": np.array([0.0, 1e-3])}, 0, 10)
    module._must_have_learned(before, before, 10, 10)
    with pytest.raises(InputError, match="0 to 10"):
        module._must_have_learned(before, before, 0, 10)
