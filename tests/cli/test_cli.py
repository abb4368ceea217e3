import json
import os
import re
import shlex
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars
import pytest

from commands import Command
from event_files import scalars
from maidenflight import cache, manifest, parameters, policy, policy_file, results
from maidenflight.flights import compensation, log, reading
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import DroneFile, Estimate, Search, Source
from maidenflight.identification.posterior import Posterior
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.training import scores
from quick import make_identification_quick, make_training_quick
from run_listing import entries, unlisted


@pytest.fixture(autouse=True)
def less_work(monkeypatch: pytest.MonkeyPatch) -> None:
    make_training_quick(monkeypatch)
    make_identification_quick(monkeypatch)


def test_a_drone_is_printed_as_toml_or_json_by_its_name_and_mass(
    tmp_path: Path, command: Command
) -> None:
    arguments = "drone crazyflie_2.0 --mass 30"
    code, out, err = command(arguments)
    assert (code, err) == (0, "")
    assert 'name = "crazyflie_2.0"' in out
    assert float(parameters.from_toml(out).mass) == np.float32(0.03)
    code, out, err = command(arguments, f"--json -o {tmp_path}/mine.toml")
    assert (code, err) == (0, "")
    said = json.loads(out)
    assert said["name"] == "crazyflie_2.0"
    assert said["output"] == str(tmp_path / "mine.toml")
    assert set(said["parameters"]) == set(parameters.QUANTITIES)
    assert said["parameters"]["mass"] == {
        "value": 0.03,
        "unit": "kg",
        "meaning": parameters.QUANTITIES["mass"].meaning,
    }
    file = drone_file.read(tmp_path / "mine.toml")
    assert file.record["settings"] == {"drone": "crazyflie_2.0", "mass": 30.0}
    np.testing.assert_array_equal(
        file.parameters.inertia, parameters.read_drone("crazyflie_2.0", 0.03).inertia
    )
    again = f"drone {tmp_path}/mine.toml -o {tmp_path}/mine.toml"
    assert command(again)[0] == 2
    assert command(f"{again} --overwrite")[0] == 0
    out = command("drone crazyflie")[1]
    assert parameters.to_toml(parameters.from_toml(out), "crazyflie") == out
    code, _, err = command("drone crazyflie_bolt")
    assert (code, len(err.splitlines())) == (2, 1)


def test_the_named_drones_are_listed(command: Command) -> None:
    _, out, _ = command("drone --list")
    _, content, _ = command("drone --list --json")
    listed = {row["name"]: row for row in json.loads(content)["drones"]}
    assert list(listed) == list(parameters.DRONES)
    for name, drone in parameters.DRONES.items():
        assert name in out
        assert drone.summary in out
        assert (listed[name]["mass"] is None) == drone.frameless


def test_help_names_every_battery_law_and_every_signal_that_can_be_ignored(
    command: Command,
) -> None:
    _, out, _ = command("identify --help-all")
    said = " ".join(out.split())
    for law in compensation.LAWS:
        assert f"'{law}'" in said
    assert f"[{'|'.join(log.OPTIONAL)}]" in said


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("identify {tmp}/nothing", "no such file or folder"),
        ("identify {tmp}/empty", "no flight logs"),
        ("identify {tmp}/odd.csv", "unknown format"),
        ("identify {tmp}/empty --bounds latency", "NAME=LOWER,UPPER"),
        ("validate {tmp}/no.toml {tmp}/empty -o {tmp}/v.csv", "no such drone"),
        ("validate crazyflie {tmp}/empty -o {tmp}/v.csv", "no flight logs"),
        ("validate crazyflie {tmp}/empty -o {tmp}/odd.csv", "already there"),
        ("identify {tmp}/empty --battery-law 'no law'", "known are"),
        ("identify {tmp}/empty --ignore position", "rotor_speed"),
        ("validate crazyflie {tmp}/empty -o {tmp}/v.csv --horizons soon", "expected seconds"),
        ("identify {tmp}/empty {tmp}/odd.csv", "put several into a folder"),
        ("identify {tmp}/empty --length 9", "--objective replay"),
        ("match {tmp}/empty -o {tmp}/m.toml", "POLICIES"),
        ("match {tmp}/empty {tmp}/odd.csv --over latency", "--over"),
        ("match {tmp}/empty {tmp}/odd.csv -o {tmp}/m.toml", "not valid JSON"),
        ("train --drone {tmp}/no.toml -o {tmp}/p", "no such drone"),
        ("train --drone {tmp}/bad.toml -o {tmp}/p", "missing"),
        ("train --drone crazyflie -o {tmp}/p --randomize posterior", "crazyflie: no [posterior]"),
        ("train -o {tmp}/p --randomize much", "posterior"),
        *(
            (f"train --drone crazyflie -o {{tmp}}/p --hidden '{sizes}'", "50,50")
            for sizes in ("50x50", "0", "50,,50", "1025", "-5", "")
        ),
        ("train --drone crazyflie --from {tmp}/odd.csv -o {tmp}/p", "JSON"),
        ("train --drone crazyflie --from {tmp}/no.json -o {tmp}/p", "no.json"),
        ("train --from {tmp}/odd.csv --memory 3 --drone crazyflie", "--memory"),
        *(
            (f"train --form raptor '{option}' '{value}' --drone crazyflie", option)
            for option, value in (("--memory", "3"), ("--hidden", "16"))
        ),
        (
            "train --drone crazyflie -o {tmp}/p --hidden 128,128 --for crazyflie",
            "22016 multiplications",
        ),
        ("export {tmp}/no.json -o {tmp}/c --propellers legacy", "propellers"),
        ("transfer {tmp}/empty -o {tmp}/t", "no policies"),
        ("transfer {tmp}/odd.csv -o {tmp}/t", "not valid JSON"),
        ("transfer {tmp}/odd.csv --reality virtual:x -o {tmp}/t", "virtual:SEED"),
        ("transfer {tmp}/odd.csv --reality far: -o {tmp}/t", "far:SEED"),
        ("transfer -o {tmp}/t", "Missing argument 'POLICIES...'"),
        ("envelope {tmp}/empty -o {tmp}/t", "no policies"),
        ("envelope {tmp}/odd.csv --along depth -o {tmp}/t", "--along"),
        ("envelope {tmp}/odd.csv -o {tmp}/full", "--resume"),
        ("sweep {tmp}/bad.toml -o {tmp}/s", "format is unknown"),
        ("predict {tmp}/empty --drone crazyflie -o {tmp}/p.csv", "no policies"),
        ("predict {tmp}/none.json --drone crazyflie -o {tmp}/p.csv", "none.json: cannot be read"),
        ("predict {tmp}/odd.csv --drone crazyflie -o {tmp}/p.csv", "odd.csv: not a policy"),
        ("predict {tmp}/other --drone crazyflie -o {tmp}/p.csv", "notes.json: not a policy"),
        ("predict {tmp}/other --drone crazyflie -o {tmp}/odd.csv", "already there"),
        ("predict {tmp}/other --drone {tmp}/no.toml -o {tmp}/p.csv", "no such drone"),
        (
            "predict {tmp}/other --drone crazyflie --randomize posterior -o {tmp}/p.csv",
            "no [posterior]",
        ),
        ("export {tmp}/no.json -o {tmp}/c", "cannot be read"),
        ("record -o {tmp}/full", "already there"),
        ("record -o {tmp}/r --flights 0", "0"),
        ("report {tmp}/empty", "empty"),
        ("drone swan", "no such drone"),
        ("fly", "--uri"),
        ("fly --uri udp://127.0.0.1:9 --steps 0.1", "--steps"),
        ("fly --uri udp://127.0.0.1:9 --pilot nobody", "policy, pid"),
        ("fly --overwrite", "--overwrite"),
        ("soar", "No such command"),
        ("record --height 1", "--height"),
        ("fly --recover -o {tmp}/nowhere", "no such folder"),
        ("record --plan {tmp}/no.toml -o {tmp}/r", "cannot be read as a flight plan"),
        ("record --plan {tmp}/bad.toml -o {tmp}/r", "flight plan of this version"),
        ("record --plan {tmp}/no.toml --duration 9", "--duration: the plan defines"),
        ("fly --plan {tmp}/no.toml --task hover", "--task: the plan defines"),
        ("plan --room 2x2", "2x2x1.5"),
        ("plan --room 0.5x2x2 -o {tmp}/p.toml", "0.8 to 100 m"),
        ("plan --room nanx2x2 -o {tmp}/p.toml", "2x2x1.5"),
        ("plan --seconds 1", "--seconds"),
        ("plan --for , -o {tmp}/p.toml", "names of parameters"),
        ("plan --for patience -o {tmp}/p.toml", "not a parameter"),
        ("plan {tmp}/no.toml -o {tmp}/p.toml", "no such drone"),
        ("plan --rate 120 -o {tmp}/p.toml", "divisor of 500"),
    ],
)
def test_a_mistake_gives_one_line_and_exit_code_2(
    arguments: str, says: str, tmp_path: Path, command: Command
) -> None:
    for folder in ("empty", "full", "other"):
        (tmp_path / folder).mkdir()
    (tmp_path / "other" / "notes.json").write_text('{"format": "another"}')
    (tmp_path / "full" / "mine.txt").write_text("keep me")
    (tmp_path / "odd.csv").write_text("a,b\n1,2\n")
    (tmp_path / "bad.toml").write_text("format = 7\n")
    code, out, err = command(arguments.format(tmp=tmp_path))
    assert code == 2
    assert says in err
    assert "Traceback" not in err
    assert out == ""
    assert (
        len([line for line in err.splitlines() if line.startswith(("maidenflight:", "Error:"))])
        == 1
    )
    assert (tmp_path / "full" / "mine.txt").read_text() == "keep me"


def next_of(out: str) -> list[str]:
    """The command that the last line of an output names."""
    told = re.fullmatch(r"next: maidenflight (.*?)(  \(.*\))?", out.splitlines()[-1])
    assert told is not None, out
    return shlex.split(told[1])


def test_an_export_names_the_report_that_shows_its_policy(tmp_path: Path, command: Command) -> None:
    file = tmp_path / "my runs" / "policies" / "policy_1.json"
    policy_file.write_policy(
        file, policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(4,)))
    )
    manifest.append(file.parent, "train", {"policies": [file]}, {})
    code, out, _ = command("export", file, f"-o {tmp_path}/firmware")
    assert code == 0
    assert next_of(out) == ["report", str(tmp_path / "my runs")]
    code, out, _ = command(next_of(out))
    assert code == 0
    assert (tmp_path / "my runs" / "report.html").exists()
    alone = tmp_path / "alone" / "pwm_1.json"
    policy_file.write_policy(
        alone, policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(4,)))
    )
    code, out, _ = command(f"export {alone} -o {tmp_path}/more")
    assert next_of(out) == ["report", "--policies", str(alone)]
    assert command(next_of(out), f"-o {tmp_path}/alone.html")[0] == 0


def test_a_folder_has_settings_of_its_own_which_options_replace(
    tmp_path: Path, monkeypatch: Any, command: Command
) -> None:
    monkeypatch.chdir(tmp_path)
    project = tmp_path / "maidenflight.toml"
    project.write_text('task = "hover"\n[drone]\ndrone = "crazyflie_2.0"\nmass = 30\n')
    code, out, err = command("drone")
    assert (code, err) == (0, "maidenflight.toml: drone, mass\n")
    assert float(parameters.from_toml(out).mass) == np.float32(0.03)
    code, out, err = command("drone --mass 31")
    assert (code, err) == (0, "maidenflight.toml: drone\n")
    assert float(parameters.from_toml(out).mass) == np.float32(0.031)
    for text, message in (
        ("tusk = 1", "tusk; expected drone, task, control, or a table"),
        ("[drone]\nmess = 1", "[drone] mess; expected "),
        ("drone = ", "cannot be read as TOML"),
    ):
        project.write_text(text)
        code, out, err = command("drone crazyflie")
        assert code == 2
        assert message in err


RECORD = "record --reality virtual:3 --flights 2 --duration 4"
LITTLE = {
    "identify": "--trials 1 --evaluations 15 --over thrust_to_weight,latency",
    "validate": "",
    "train": "--yaw-penalty 0.1 --updates 2",
    "transfer": "--trials 1 --duration 0.5",
    "predict": "--trials 1 --duration 0.2",
    "export": "",
    "report": "",
}
"""What follows a recording, in order, and options with which it is quick; training is that of the
README, which is compiled anyway."""


@pytest.mark.slow
def test_each_command_names_the_next_which_runs(
    tmp_path: Path, monkeypatch: Any, command: Command
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command(f"{RECORD} --seed 1 -o others")[0] == 0
    code, out, err = command(RECORD)
    for name, options in LITTLE.items():
        assert code == 0
        following = ["others" if word == "OTHER_LOGS" else word for word in next_of(out)]
        assert following[0] == name
        code, out, err = command(following, options)
    assert code == 0, err
    assert (tmp_path / "report.html").exists()
    assert (tmp_path / "identification.svg").read_text().startswith("<svg")
    assert unlisted(tmp_path) == {"report.html", "policies/training.npz"}
    assert entries(tmp_path)["validate", "validation.csv"] == {"validation", "windows"}
    assert "no longer there" not in (tmp_path / "report.html").read_text()


PAPERS = "--objective replay --method bayesian --trials 1 --evaluations 20"


@pytest.mark.parametrize(
    ("settings", "names", "evaluations"),
    [
        pytest.param(
            LITTLE["identify"], {"thrust_to_weight", "latency"}, None, marks=pytest.mark.slow
        ),
        pytest.param(
            PAPERS,
            {"thrust_to_weight", "motor_time_constant", "latency"},
            20 + 3 * 64,
            marks=pytest.mark.night,
        ),
    ],
    ids=["likelihood", "replay"],
)
def test_the_line_from_logs_to_report_in_json(
    settings: str, names: set[str], evaluations: int | None, tmp_path: Path, command: Command
) -> None:
    def said(words: str) -> dict[str, Any]:
        code, out, err = command(words, "--json")
        assert code == 0, err
        assert len(out.splitlines()) == 1
        return json.loads(out)

    logs, drone, policies = tmp_path / "recorded", tmp_path / "drone.toml", tmp_path / "policies"
    recorded = said(f"{RECORD} -o {logs}")
    assert [Path(path).name for path in recorded["flights"]] == ["flight_01.csv", "flight_02.csv"]
    assert recorded["simulated"] is True

    identified = said(f"identify {logs} -o {drone} {settings}")
    assert set(identified["parameters"]) == names
    for estimate in identified["parameters"].values():
        assert estimate["interval"][0] <= estimate["value"] <= estimate["interval"][1]
    assert np.isfinite(identified["value"])
    if evaluations is not None:
        assert identified["windows"] > 50
        assert identified["evaluations"] == evaluations
        assert identified["value"] > 0
    assert identified["windows"] > 0
    assert identified["seconds"] > 0
    value = identified["parameters"]["latency"]["value"]
    assert float(parameters.read_drone(drone).latency) == pytest.approx(value, rel=1e-6)
    assert (tmp_path / "identification.csv").exists()
    assert identified["picture"] == str(tmp_path / "identification.svg")

    trained = said(f"train --drone {drone} -o {policies} --yaw-penalty 0.1 --updates 2")
    assert [Path(path).name for path in trained["policies"]] == [
        f"policy_{number}.json" for number in (1, 2, 3)
    ]
    assert policy_file.read_policy(trained["policies"][0]).policy.layer_sizes == (
        40,
        50,
        50,
        4,
    )

    little = "--trials 1 --duration 0.5"
    flown = said(f"transfer {policies} --reality virtual:3 -o {tmp_path}/transfer {little}")
    assert len(flown["flights"]) == 3
    assert {"duration", "end_reason", "position_error"} <= set(flown["flights"][0])

    exported = said(f"export {trained['policies'][0]} -o {tmp_path}/firmware")
    assert {Path(path).name for path in exported["files"]} == {"policy.h", "policy.c"}

    page = Path(said(f"report {tmp_path}")["report"])
    assert page == tmp_path / "report.html"
    assert "simulated" in page.read_text()
    assert unlisted(tmp_path) == {"report.html", "policies/training.npz"}

    others = f"--logs {logs} --drone {drone} --policies {policies}"
    look = Path(said(f"report {others} -o {tmp_path}/look.html")["report"])
    assert "3 policies" in look.read_text()
    assert said(f"report {policies}")["report"] == str(policies / "report.html")


@pytest.mark.slow
def test_flight_times_of_ours_and_the_authors_policies_are_predicted(
    tmp_path: Path, command: Command
) -> None:
    names = ("ours", "attitude_rate_007.json", "drone.toml", "p.csv")
    ours, theirs, drone, output = (tmp_path / name for name in names)
    for number in range(3):
        small = policy.untrained_policy(jax.random.key(number), spec=PolicySpec(hidden=(8,)))
        policy_file.write_policy(ours / f"policy_{number}.json", small)
    still = {"type": "standard", "weights": [[0.0] * 40] * 4, "biases": [0.0] * 4}
    scaling = [[0.0] * 40, [1.0] * 40]
    content = {"check_sum": "0.0", "scaling_parameters": scaling, "activation": "relu", "0": still}
    theirs.write_text(json.dumps(content))
    DroneFile(
        parameters.crazyflie(),
        {"torque_bias_x": Estimate(0.0, (-1e-4, 1e-4), (0.0,), 3e-4)},
        Posterior({"latency": np.array([0.001, 0.03])}),
        Source(2, 60.0, True, "subsampled", 60000.0),
        Search("likelihood", -15.0, 60, 3),
    ).write(drone)
    arguments = f"predict {theirs} {ours} {ours}/policy_1.json --drone {drone} -o {output}"
    arguments += " --duration 2 --trials 5 --against pid"
    code, out, err = command(arguments, "--json")
    assert code == 0, err
    said = json.loads(out)
    assert (said["simulated"], said["output"]) == (True, str(output))
    assert entries(tmp_path) == {("predict", "p.csv"): {"prediction"}}
    files = [theirs, *(ours / f"policy_{number}.json" for number in range(3))]
    assert [entry["file"] for entry in said["policies"]] == list(map(str, files))
    assert [entry["control"] for entry in said["policies"]] == ["attitude_rate", *["pwm"] * 3]
    flown = polars.read_csv(output, comment_prefix="#")
    expected = ["policy", "control", "duration", "end_reason", "trial", "drone"]
    assert flown.columns[:6] == expected
    for entry, file in zip(said["policies"], files, strict=True):
        own = flown.filter(polars.col("policy") == file.stem)
        assert own.height == sum(entry["end_reasons"].values()) == 5
        assert entry["quantiles"]["0.5"] == np.median(own["duration"].to_numpy())
        assert entry["end_reasons"] == dict(own["end_reason"].value_counts().rows())
        assert entry["outlives"][file.stem] == 0.5
        assert set(entry["outlives"]) == {one.stem for one in files}
    made = json.loads(output.read_text().splitlines()[1].removeprefix("# record: "))
    read = [one.split(" ")[0] for one in made["inputs"]]
    assert read == ["drone.toml", *(file.name for file in files)]
    assert made["settings"] == {
        "drone": "drone.toml",
        "against": ["pid"],
        "trials": 5,
        "duration": 2.0,
        "randomize": "trim",
        "accept_bounds": False,
    }

    first = output.read_bytes()
    code, out, err = command(arguments)
    assert code == 2
    assert "already there" in err
    assert output.read_bytes() == first
    code, out, err = command(arguments, "--overwrite")
    assert code == 0, err
    assert output.read_bytes() == first
    assert "Predicted flight times, simulated" in out
    assert "of 5" in out
    assert command(arguments, "--overwrite --randomize posterior")[0] == 0
    assert output.read_bytes() != first


@pytest.mark.night
def test_flight_times_under_published_conditions_are_others_and_recorded(
    tmp_path: Path, command: Command
) -> None:
    ours, output = tmp_path / "policy.json", tmp_path / "p.csv"
    small = policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(8,)))
    policy_file.write_policy(ours, small)
    published = Path(__file__).parents[2] / "paper" / "settings" / "gronauer_2021.toml"
    arguments = f"predict {ours} --drone crazyflie -o {output} --duration 2 --trials 2 --json"
    assert command(arguments, "--against pid")[0] == 0
    usual = output.read_bytes()
    assert command(arguments, f"--against pid --conditions {published} --overwrite")[0] == 0
    assert output.read_bytes() != usual
    made = json.loads(output.read_text().splitlines()[1].removeprefix("# record: "))
    assert made["settings"]["conditions"].endswith(published.name)
    assert any(one.startswith(f"{published.name} ") for one in made["inputs"])


@pytest.mark.night
def test_policies_are_trained_over_what_flights_leave_possible(
    tmp_path: Path, command: Command
) -> None:
    logs, drone, policies = tmp_path / "recorded", tmp_path / "drone.toml", tmp_path / "policies"
    assert command(f"{RECORD} -o {logs}")[0] == 0

    code, _, err = command(f"identify {logs} -o {drone} --over auto --objective replay")
    assert code == 2
    assert "chosen by likelihood only" in err
    assert not drone.exists()

    code, out, err = command(
        f"identify {logs} -o {drone} --over thrust_to_weight,inertia_x --trials 1",
        "--evaluations 15 --json",
    )
    assert code == 0, err
    assert set(json.loads(out)["parameters"]) == {"thrust_to_weight", "inertia_x"}
    written = drone_file.read(drone)
    assert written.search is not None
    assert written.search.objective == written.record["settings"]["objective"] == "likelihood"
    assert list(written.posterior) == ["thrust_to_weight", "inertia_x"]

    trained = f"train --drone {drone} -o {policies} --updates 2"
    code, out, err = command(trained, "--randomize posterior")
    assert code == 0, err
    made = json.loads((policies / "policy_1.json").read_text())["record"]["settings"]
    assert made["randomize"] == "posterior"
    assert made["yaw_penalty"] == 0.0
    code, out, err = command(trained, "--randomize wide --yaw-penalty 0.1 --overwrite")
    assert code == 0, err
    made = json.loads((policies / "policy_1.json").read_text())["record"]["settings"]
    assert (made["randomize"], made["yaw_penalty"]) == ("wide", 0.1)


@pytest.mark.slow
def test_training_that_is_interrupted_says_how_to_go_on_and_does(
    tmp_path: Path, monkeypatch: Any, command: Command
) -> None:
    folder, whole = tmp_path / "stopped", tmp_path / "whole"
    what = "train --drone crazyflie --yaw-penalty 0.1 --updates 3 --log tensorboard"
    describe = scores.describe

    def interrupt(*_: Any) -> str:
        raise KeyboardInterrupt

    code, _, err = command(f"{what} -o {folder} --resume")
    assert code == 2
    assert "no training to resume" in err

    monkeypatch.setattr(scores, "describe", interrupt)
    code, _, err = command(f"{what} -o {folder}")
    assert code == 130
    assert f"Go on with: maidenflight {what} -o {folder} --resume" in err
    assert sorted(path.name for path in folder.iterdir()) == ["tensorboard", "training.npz"]

    monkeypatch.setattr(scores, "describe", describe)
    code, _, err = command(f"{what} -o {folder}")
    assert code == 2
    assert "--resume" in err
    code, _, err = command(f"{what} --seed 1 -o {folder} --resume")
    assert code == 2
    assert "a checkpoint of another training" in err
    for place, further in ((folder, "--resume"), (whole, "")):
        code, _, err = command(f"{what} -o {place} {further}")
        assert code == 0, err
    assert sorted(path.name for path in folder.iterdir()) == [
        *(f"policy_{number}.json" for number in (1, 2, 3)),
        "tensorboard",
        "training.csv",
        "training.npz",
    ]
    for name in ("policy_1.json", "training.csv", "training.npz"):
        assert (folder / name).read_bytes() == (whole / name).read_bytes()
    shown = scalars(folder / "tensorboard" / "policy_1")
    assert shown == scalars(whole / "tensorboard" / "policy_1")
    assert len(shown) == 4 * polars.read_csv(folder / "training.csv")["update"].n_unique()

    # Without --updates the number is the training's own.
    code, _, err = command(what.replace("--updates 3 ", ""), f"-o {folder} --resume")
    assert code == 0, err
    assert (folder / "policy_1.json").read_bytes() == (whole / "policy_1.json").read_bytes()


@pytest.mark.parametrize(
    ("board", "package"), [("tensorboard", "tensorboardX"), ("wandb", "wandb")]
)
def test_a_board_whose_package_is_missing_is_said_before_training_begins(
    board: str, package: str, tmp_path: Path, monkeypatch: Any, command: Command
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    code, out, err = command(f"train --drone crazyflie -o {tmp_path}/policies --log {board}")
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert f"pip install -e '.[{board}]'" in err
    assert not (tmp_path / "policies").exists()


@pytest.mark.slow
def test_a_drone_is_validated(tmp_path: Path, command: Command) -> None:
    logs, output, drone = tmp_path / "recorded", tmp_path / "validation.csv", tmp_path / "mine.toml"
    assert command(f"{RECORD} -o {logs}")[0] == 0
    assert command(f"drone crazyflie -o {drone}")[0] == 0
    arguments = f"validate {drone} {logs} -o {output} --horizons 0.05,0.3"
    code, out, err = command(arguments)
    assert code == 0, err
    for said in (
        "mine.toml",
        "paper's crazyflie",
        "persistence",
        "0.05 s",
        "0.3 s",
        "simulated",
        str(output),
    ):
        assert said in out
    assert err == ""
    assert out.index("nats a row") < out.index("persistence")
    assert command(arguments)[0] == 2
    code, out, err = command(arguments, "--overwrite --json")
    assert code == 0, err
    assert len(out.splitlines()) == 1
    said = json.loads(out)
    assert said["simulated"] is True
    assert len(said["errors"]) == 8
    mine, papers, unturned = said["log_likelihoods"].values()
    assert mine == papers > unturned + 0.1
    written = polars.read_csv(output, comment_prefix="#")
    for row, entry in zip(written.iter_rows(named=True), said["errors"], strict=True):
        assert row == pytest.approx(entry, abs=1e-8)
    mine, papers = (
        written.filter(polars.col("model") == name).drop("model")
        for name in ("mine.toml", "paper's crazyflie")
    )
    assert mine.equals(papers)
    assert "mine.toml sha256:" in output.read_text()
    assert list(reading.read_flights(tmp_path).paths) == sorted(logs.glob("*.csv"))

    for horizons, expected in (("0,0.1", "horizons"), ("9", "no flight is long enough")):
        code, out, err = command(
            f"validate {drone} {logs} -o {tmp_path}/v.csv --horizons {horizons}"
        )
        assert (code, out, len(err.splitlines())) == (2, "", 1)
        assert expected in err
    assert not (tmp_path / "v.csv").exists()


@pytest.mark.slow
def test_with_two_motors_exchanged_a_drone_that_commands_do_not_turn_is_likelier(
    tmp_path: Path, command: Command
) -> None:
    assert command(f"{RECORD} -o {tmp_path}/recorded")[0] == 0
    (tmp_path / "exchanged").mkdir()
    for recorded in (tmp_path / "recorded").glob("*.csv"):
        text = recorded.read_text()
        assert "command_1,command_2" in text
        exchanged = text.replace("command_1,command_2", "command_2,command_1")
        (tmp_path / "exchanged" / recorded.name).write_text(exchanged)
    code, out, _ = command(
        f"validate crazyflie {tmp_path}/exchanged -o {tmp_path}/v.csv", "--faulty use --json"
    )
    said = json.loads(out)
    assert code == 0
    assert (
        said["log_likelihoods"]["crazyflie, not turned by commands"]
        > 0.1 + (said["log_likelihoods"]["crazyflie"])
    )
    assert any("not turned by commands" in doubt for doubt in said["doubts"])


@pytest.mark.slow
def test_flights_that_made_the_drone_are_called_no_test(tmp_path: Path, command: Command) -> None:
    logs, drone = tmp_path / "recorded", tmp_path / "drone.toml"
    command(f"{RECORD} -o {logs}")
    made = results.record(seed=0, inputs=[logs / "flight_01.csv"], settings={})
    DroneFile(parameters.crazyflie(), record=made).write(drone)
    code, _, err = command(f"validate {drone} {logs} -o {tmp_path}/v.csv --horizons 0.1")
    assert code == 0
    assert "identified from 1 of these 2 files" in err


def test_compiled_programs_are_kept_by_processor_and_the_oldest_go(
    tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cache.keep_compiled()
    folder = Path(os.environ["JAX_COMPILATION_CACHE_DIR"])
    assert folder.parent == tmp_path / "maidenflight"
    monkeypatch.setattr(cache, "_CACHE_BYTES", 25)
    for age, name in enumerate(("new-cache", "older-cache", "oldest-cache")):
        (folder / name).write_bytes(bytes(10))
        os.utime(folder / name, (1e9 - age, 1e9 - age))
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    cache.keep_compiled()
    assert {path.name for path in folder.iterdir()} == {"new-cache", "older-cache"}
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setattr(cache, "_processor", lambda: "another")
    cache.keep_compiled()
    assert Path(os.environ["JAX_COMPILATION_CACHE_DIR"]).parent == folder.parent
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] != str(folder)


def test_where_programs_cannot_be_kept_or_are_kept_elsewhere_nothing_happens(
    tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "")
    cache.keep_compiled()
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == ""
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    cache.keep_compiled()
    assert "JAX_COMPILATION_CACHE_DIR" not in os.environ


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        ("identfy flights", "did you mean identify?"),
        ("export p.json --to px", "did you mean px4?"),
        ("identify flights --mass 0.033", "from 5 to 5000 g"),
    ],
)
def test_a_mistyped_word_is_answered_by_what_it_resembles(words, hint, command):
    code, _, err = command(words)
    assert code == 2
    assert hint.lower() in err.lower()
