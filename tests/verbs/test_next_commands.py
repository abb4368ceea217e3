"""Transfer leads to predict, predict to export only if its verdict is good; export repeats it."""

from pathlib import Path

import jax
import polars
import pytest

from maidenflight import manifest, policy_file, results, run_folder
from maidenflight.experiments.verdict import Verdict
from maidenflight.policy import untrained_policy
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.verbs.export import Export
from maidenflight.verbs.predict import Predict
from maidenflight.verbs.transfer import Transfer

BAD = Verdict(False, "Do not fly: of policy_1, 6 of 16 end by height.")
RECORD = {
    "drone": {"name": "crazyflie", "mass": 0.028},
    "settings": {"task": "hover", "randomize": "wide", "yaw_penalty": 0.1},
}


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    network = untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(4,)))
    return policy_file.write_policy(tmp_path / "policies/policy_1.json", network, RECORD)


def test_a_transfer_leads_to_the_judge_on_the_drone_that_it_named(policy: Path) -> None:
    place = str(policy.parent)
    by_drone = Transfer(policies=(place,), drone="crazyflie")
    by_reality = Transfer(policies=(place,), reality=("far:3@crazyflie+10ms",))
    for verb in (by_drone, by_reality):
        assert verb.choose_next(policy) == ("predict", place, "--drone", "crazyflie")
    unnamed = Transfer(policies=(place,), task="hover").choose_next(policy)
    assert unnamed == ("predict", place, "--drone", "DRONE", "--task", "hover")


def test_a_bad_verdict_leads_to_what_mends_it(policy: Path) -> None:
    verb = Predict(policies=(str(policy),), drone="crazyflie")
    words, _ = verb._mend(policy, Verdict(True, "Fly."), 0.0)
    assert words == ("export", policy)
    words, _ = verb._mend(policy, BAD, 0.0)
    again = policy.parents[1] / "policies_2"
    more = ("--randomize", "any-day", "--task", "hover", "--yaw-penalty", 0.1, "-o", again)
    assert words == ("train", "--drone", "crazyflie", "--from", policy, *more)
    words, _ = Predict(policies=(str(policy),), drone="x500")._mend(policy, BAD, 0.0)
    assert words[:5] == ("train", "--drone", "x500", "--control", "pwm")


def test_policies_of_another_drone_are_named(policy: Path) -> None:
    verb = Transfer(policies=(str(policy),), reality=("virtual:1@x500", "virtual:1@crazyflie"))
    (line,) = verb.describe_other_drones(verb.flying_drones)
    assert "28.0 g, but x500 has 2,064.3 g" in line
    usual = Transfer(policies=(str(policy),))
    assert usual.describe_other_drones(usual.flying_drones) == []
    heavy = policy_file.read_policy(policy)
    policy_file.write_policy(policy, heavy.policy, {"drone": {"name": "x500", "mass": 2.0643}})
    usual = Transfer(policies=(str(policy),), reality=("near:3+payload15",))
    (line,) = usual.describe_other_drones(usual.flying_drones)
    assert "but near:3 has 28.5 g" in line


def test_an_export_repeats_the_last_bad_verdict(policy: Path, tmp_path: Path) -> None:
    file = tmp_path / run_folder.PREDICTION.name
    row = {"policy": "policy_1", "control": "pwm", "trial": 1, "duration": 1.0}
    for number, good in enumerate((True, False, True)):
        entry = {"policy": results.digest(policy), "good": good, "sentence": BAD.sentence}
        table = polars.DataFrame([{**row, "end_reason": "height"}])
        run_folder.PREDICTION.write(file, table, {"verdicts": [entry]})
        manifest.append(file, "predict", {"prediction": [file]}, {})
        notes = Export(policy=policy).run(tmp_path / f"c_{number}").notes
        assert [BAD.sentence in note for note in notes] == ([] if good else [True])
