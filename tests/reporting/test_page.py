"""The report: what is there is shown, what is missing is left out, and the page works in a browser
without a network."""

import base64
import dataclasses
import hashlib
import itertools
import json
import re
import shutil
import subprocess
from dataclasses import replace
from os import environ
from pathlib import Path
from urllib.parse import unquote

import jax
import numpy as np
import polars
import pytest

from maidenflight import manifest, parameters, policy_file, results, run_folder
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import Transfer
from maidenflight.flights import flight_csv
from maidenflight.flights.checkup.result import LogWarning
from maidenflight.flights.log import Flight
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import (
    DroneFile,
    Estimate,
    GroupGain,
    Search,
    Source,
)
from maidenflight.identification.posterior import Posterior
from maidenflight.integrations.exporters.authors_json import export_authors_json
from maidenflight.policy import untrained_policy
from maidenflight.reporting import page as page_module
from maidenflight.reporting import run as runs
from maidenflight.reporting.page import report, report_comparison
from maidenflight.reporting.sections import comparison
from maidenflight.reporting.sections import flights as flight_section
from maidenflight.reporting.sections import head as head_section
from maidenflight.reporting.sections import parameters as parameter_section
from maidenflight.reporting.sections.flights import NAMES as STRUCTURES
from maidenflight.simulator.controllers.interface import INTERFACES
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.verbs.report import Report

CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)
RECORD = {"version": "0.1.0", "seed": 7, "settings": {"reality": "virtual:1"}}
NAMES = ("thrust_to_weight", "motor_time_constant", "latency")


def circling(duration: float, simulated: str = "virtual:1") -> Flight:
    """A flight around the paper's circle, 1 cm off, rolled by 0.1 rad."""
    time = np.arange(0, duration, 0.01)
    angle, full = 2 * np.pi * time / 3, np.ones_like(time)
    setpoint = np.stack([0.25 * np.cos(angle), 0.25 * np.sin(angle), full], axis=1)
    attitude = np.stack([0.1 * full, 0 * full, 0 * full], axis=1)
    position, still = setpoint + np.array([0.0, 0.0, 0.01]), np.zeros_like(setpoint)
    command = np.full((len(time), 4), 0.55)
    return Flight(
        "flight",
        0.01,
        position,
        still,
        attitude,
        still,
        command,
        4.0 * full,
        setpoint,
        True,
        simulated,
    )


def flown(simulated: str = "virtual:1", reason: str = "tilt") -> Transfer:
    durations = [2.0, 0.5, 10.0]
    table = polars.DataFrame(
        {
            "flight": [1, 2, 3],
            "policy": ["1", "1", "2"],
            "reality": ["virtual:1"] * 3,
            "trial": [1, 2, 1],
            "duration": durations,
            "end_reason": ["position error", reason, "time limit"],
            "position_error": [0.011, float("nan"), 0.0123],
            "command_change": [0.01, 0.4, 0.02],
            "at_limits": [0.0, 0.3, 0.0],
        }
    )
    return Transfer(table, tuple(circling(duration, simulated) for duration in durations))


ENTRIES: tuple[tuple[str, str, dict[manifest.Kind, list[str]]], ...] = (
    ("record", "recorded", {"logs": ["recorded/flight_01.csv"], "truth": ["reality.toml"]}),
    ("identify", "drone.toml", {"drone": ["drone.toml"], "evaluations": ["identification.csv"]}),
    (
        "validate",
        "validation.csv",
        {"validation": ["validation.csv"], "windows": ["validation_windows.csv"]},
    ),
    (
        "train",
        "policies",
        {"policies": ["policies/policy_1.json"], "training": ["policies/training.csv"]},
    ),
    (
        "transfer",
        "transfer",
        {
            "flights": ["transfer/flights.csv"],
            "flight_logs": [f"transfer/flight_0{number}.csv" for number in (1, 2, 3)],
        },
    ),
    ("demo", "demo.json", {"stages": ["demo.json"]}),
)
"""Verb, output and files of each entry of a whole run."""


def list_files(folder: Path) -> None:
    """Writes the manifest of a run folder, of what is there."""
    for verb, output, written in ENTRIES:
        files: dict[manifest.Kind, list[Path]] = {
            kind: [folder / name for name in names] for kind, names in written.items()
        }
        if any(path.exists() for paths in files.values() for path in paths):
            manifest.append(folder / output, verb, files, RECORD)


@pytest.fixture
def run(tmp_path):
    """A run folder with everything in it."""
    folder = tmp_path / "run"
    drone = parameters.crazyflie()
    estimates = {
        name: Estimate(value, (0.99 * value, 1.01 * value), (value,), 0.0021)
        for name, value in ((name, float(getattr(drone, name))) for name in NAMES)
    }
    truth = parameters.replace(drone, spin_down_ratio=1.5, estimator_delay=0.004)
    DroneFile(truth, record=RECORD).write(folder / "reality.toml")
    samples = np.array([[1.72 + i / 1000, 0.088 - i / 1e4, 0.018] for i in range(9)])
    DroneFile(
        drone,
        estimates,
        Posterior(dict(zip(NAMES, samples.T, strict=True))),
        Source(2, 20.0, True, "subsampled", 60000.0),
        Search("replay", 1.0, 258, 9),
        record=RECORD,
    ).write(folder / "drone.toml")
    flight_csv.write(folder / "recorded" / "flight_01.csv", circling(3.0), RECORD)
    grid = [
        {
            "trial": 1,
            "thrust_to_weight": 1.7,
            "motor_time_constant": 0.08 + i / 1000,
            "latency": 0.018,
            "objective": 5.0 + i,
        }
        for i in range(9)
    ]
    polars.DataFrame(grid).write_csv(folder / "identification.csv")
    for name, table in (("validation", errors()), ("validation_windows", windows())):
        (folder / f"{name}.csv").write_text(
            f"# {name}\n# record: {json.dumps(RECORD)}\n{table.write_csv()}"
        )
    (folder / "policies").mkdir()
    small = untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(3,)))
    policy_file.write_policy(folder / "policies" / "policy_1.json", small, RECORD)
    steps = {
        "update": [1, 2],
        "steps": [1000000, 2000000],
        "policy": [1, 1],
        "episode_return": [-9.0, -5.0],
        "survival": [0.5, 1.0],
    }
    polars.DataFrame(steps | {"position_error": [0.1, 0.02]}).write_csv(
        folder / "policies" / "training.csv"
    )
    tested = flown()
    for number, flight in enumerate(tested.flights, 1):
        flight_csv.write(folder / "transfer" / f"flight_{number:02d}.csv", flight, RECORD)
    tested.table.write_csv(folder / "transfer" / "flights.csv")
    (folder / "demo.json").write_text(json.dumps({"stages": {"record": 1.5, "train": 3.0}}))
    list_files(folder)
    return folder


def errors() -> polars.DataFrame:
    """Errors of two models at two horizons."""
    rows = []
    for size, model in ((1.0, "drone.toml"), (2.0, "persistence")):
        for horizon in (0.1, 0.5):
            each = dict.fromkeys(("position", "velocity", "attitude", "body_rates"), size * horizon)
            ends = {
                f"{column}{end}": size * horizon for column in each for end in ("_low", "_high")
            }
            rows.append({"model": model, "horizon": horizon, **each, **ends})
    return polars.DataFrame(rows)


def windows() -> polars.DataFrame:
    """A window, logged and predicted."""
    columns = dict.fromkeys(
        ("position_z", "roll", "pitch", "body_rate_x", "body_rate_y"), [1.0, 1.1, 1.2] * 2
    )
    return polars.DataFrame(
        {
            "window": [1] * 6,
            "model": ["logged"] * 3 + ["drone.toml"] * 3,
            "time": [0.0, 0.1, 0.2] * 2,
            **columns,
        }
    )


def page(source, tmp_path, **files) -> str:
    """The page, with one space where it has any."""
    return re.sub(r"\s+", " ", report(source, tmp_path / "page.html", **files).read_text())


def file(content: str, name: str) -> polars.DataFrame:
    """A table of the page as the link beside it saves it."""
    [saved] = re.findall(
        rf'download="{name}.csv" href="data:text/csv;charset=utf-8,([^"]*)"', content
    )
    return polars.read_csv(unquote(saved).encode())


PARTS = {
    "drone.toml": 'class="sortable estimates"',
    "validation.csv": 'id="horizons"',
    "validation_windows.csv": 'id="windows"',
    "policies/training.csv": 'id="learning"',
    "transfer": '<section id="flights">',
    "reality.toml": 'data-column="truth"',
}


def test_a_whole_run_shows_every_part(run, tmp_path):
    content = page(run, tmp_path)
    assert [name for name, mark in PARTS.items() if mark not in content] == []
    assert "132.0 <small>(slowing down)" in content  # ms at the border
    assert "22.0 <small>(command + sensors)" in content
    assert "87.12 .. 88.88" not in content
    assert "87.1 .. 88.9" in content
    assert "no real drone flew" in content
    assert "<span class=badge>simulated</span>" in content


def test_the_page_does_not_depend_on_how_long_stages_took(run, tmp_path):
    before = page(run, tmp_path)
    (run / "demo.json").write_text(json.dumps({"stages": {"record": 99.5, "train": 77.0}}))
    assert page(run, tmp_path) == before


@pytest.mark.parametrize("missing", PARTS)
def test_a_missing_part_is_left_out_and_the_rest_stays(run, tmp_path, missing):
    (shutil.rmtree if (run / missing).is_dir() else lambda path: path.unlink())(run / missing)
    content = page(run, tmp_path)
    assert {name for name, mark in PARTS.items() if mark not in content} == {missing}
    assert f"Listed in run.json, but no longer there: {missing}" in content


def test_a_drone_without_draws_has_no_corner_plot(run, tmp_path):
    assert 'id="corner"' in page(run, tmp_path)
    changed(run, posterior={})
    assert 'id="corner"' not in page(run, tmp_path)


def test_test_flights_alone_make_a_page(tmp_path):
    content = page(flown(), tmp_path)
    assert "3 test flights" in content
    assert 'id="training"' not in content
    assert "<b>1 <small>of 3" in content
    assert (
        file(content, "flights")
        .fill_nan(None)
        .equals(flown().table.fill_nan(None).with_columns(polars.col("policy").cast(polars.Int64)))
    )


def test_a_log_without_a_state_shows_the_signals_that_it_has() -> None:
    whole = circling(3.0, "")
    nowhere = np.full_like(whole.position, np.nan)
    blind = replace(whole, position=nowhere, velocity=nowhere)
    content = str(flight_section.recorded(runs.Run(recorded=(blind,))))
    assert "id=viewer" not in content
    (drawn,) = re.findall(r'id="signals-1"><script type="application/json">(.*?)</script>', content)
    titles = [panel["title"] for panel in json.loads(drawn)["panels"]]
    assert [title.split()[0] for title in titles] == ["roll,", "body", "commands"]
    assert "hover_command" not in re.findall(r'data-column="(\w+)"', content)
    both = str(flight_section.recorded(runs.Run(recorded=(whole, blind))))
    assert both.count('id="signals-') == 1, "the other is in the viewer"
    tested = runs.Run(recorded=(whole,), table=flown().table, flights=flown().flights)
    assert 'id="signals-' not in str(flight_section.recorded(tested)), "test flights are in it"


def test_real_flights_are_not_called_simulated(tmp_path):
    content = page(flown(simulated=""), tmp_path)
    assert "<span class=badge>real</span>" in content
    assert "Everything here is simulated" not in content


REAL = Source(14, 270.3, False, "subsampled", 60000.0)
ALL_SIMULATED = "Everything here is simulated"


@pytest.fixture
def own(run):
    """The folder of somebody whose drone was identified from real flights that lie elsewhere."""
    (run / "reality.toml").unlink()
    shutil.rmtree(run / "recorded")
    drone = run / "drone.toml"
    drone.write_text(
        drone.read_text().replace(
            "[record]\n", '[record]\ninputs = ["mine.csv sha256:a", "too.csv sha256:b"]\n'
        )
    )
    (run / "validation.csv").write_text(
        "# what\n# record: "
        f"{json.dumps(RECORD | {'inputs': ['drone.toml sha256:0', 'mine.csv sha256:a']})}\n"
        f"{errors().write_csv()}"
    )
    (run / "prediction.csv").write_text(
        "policy,control,end_reason,trial,duration\npolicy_1,pwm,tilt,1,2.0\n"
    )
    manifest.append(run / "prediction.csv", "predict", {"prediction": [run / "prediction.csv"]}, {})
    return run


def changed(folder, **changes):
    """Writes the drone file anew, with other contents."""
    path = folder / "drone.toml"
    dataclasses.replace(drone_file.read(path), **changes).write(path)


def test_a_drone_of_real_flights_is_not_called_simulated(own, tmp_path):
    changed(own, source=REAL)
    content = page(own, tmp_path)
    assert (
        "<h1>A drone identified from 14 real flights, 270 s <span class=badge>test flights "
        "simulated</span></h1>" in content
    )
    assert (
        "3 parameters identified from 14 real flights (270 s), thrust-to-weight ratio 1.725, motor "
        "time constant 88.0 ms and latency 18.00 ms." in content
    )
    assert (
        "These flights are simulated: 1 flight of 1 policy predicted on an identified drone and 3 "
        "test flights flown on" in content
    )
    assert (
        "Identified from 14 real flights, 270 s, cut into 258 windows; commands were taken as "
        "subsampled from a faster loop." in content
    )
    assert ALL_SIMULATED not in content


@pytest.mark.parametrize("logs", ["of the same flights", "of others"])
def test_logs_that_lie_here_tell_only_of_themselves(run, tmp_path, logs):
    place, drone = run / "recorded" / "flight_01.csv", run / "drone.toml"
    used = results.digest(place) if logs == "of the same flights" else "0"
    drone.write_text(
        drone.read_text().replace(
            "[record]\n", f'[record]\ninputs = ["flight_01.csv sha256:{used}"]\n'
        )
    )
    content = page(run, tmp_path)
    assert (ALL_SIMULATED in content) == (logs == "of the same flights")


def test_that_some_flights_were_simulated_does_not_make_all_so(own, tmp_path):
    content = page(own, tmp_path)
    assert ", some or all simulated" in content
    assert ALL_SIMULATED not in content


def test_gains_of_groups_and_between_sds_are_in_the_tables(run, tmp_path):
    gains = GroupGain("motor_coasting<", -0.02, 0.004, False), GroupGain("drag", 1e-5, None, False)
    changed(run, gains=gains)
    content = page(run, tmp_path)
    assert "motor coasting&lt;" in content
    assert [GroupGain(*row) for row in file(content, "gains").iter_rows()] == list(gains)
    sd = file(content, "estimates").filter(parameter="latency")["between_sd"]
    assert sd.item() == 0.0021


def test_effects_that_were_identified_are_not_blamed(run, tmp_path):
    truth = parameters.replace(
        parameters.crazyflie(),
        latency=0.03,
        battery_resistance=0.5,
        drag_x=0.3,
        spin_down_ratio=1.3,
    )
    DroneFile(truth).write(run / "reality.toml")
    changed(
        run,
        estimates={
            **drone_file.read(run / "drone.toml").estimates,
            "drag_x": Estimate(0.3, (0.29, 0.31), (0.3,), 0.0),
            "spin_down_ratio": Estimate(1.3, (1.2, 1.4), (1.3,), 0.0),
        },
    )
    content = page(run, tmp_path)
    assert "The truth lies outside the interval of 1 of these 5 parameters." in content
    assert "identified parameters make up for them: a sagging battery." in content
    assert "(slowing down)" not in content, (
        "a model with both time constants has one truth for each"
    )


def test_an_interval_at_a_search_bound_is_called_too_narrow(run, tmp_path):
    assert "at its search bound" not in page(run, tmp_path)
    estimates = drone_file.read(run / "drone.toml").estimates
    thrust = dataclasses.replace(estimates["thrust_to_weight"], bounds=(1.5, 1.725))
    changed(run, estimates={**estimates, "thrust_to_weight": thrust})
    assert page(run, tmp_path).count("at its search bound") == 1


def test_what_does_no_better_than_persistence_is_marked_and_explained(run, tmp_path):
    worse = errors().with_columns(
        attitude=polars.when(polars.col("model") == "drone.toml").then(9.0).otherwise("attitude")
    )
    (run / "validation.csv").write_text(f"# what\n{worse.write_csv()}")
    content = page(run, tmp_path)
    assert content.count(" * <small>") == 2
    assert content.count("persistence baseline") == 1


def test_what_the_page_leaves_out_is_named(run, tmp_path):
    assert "not on this page" not in page(run, tmp_path)
    for old, new in (("policies", "hover"), ("transfer", "transfer_<b>")):
        shutil.copytree(run / old, run / new)
    manifest.append(run / "hover", "train", {"policies": [*(run / "hover").iterdir()]}, {})
    flights = run / "transfer_<b>" / "flights.csv"
    manifest.append(flights.parent, "transfer", {"flights": [flights]}, {})
    shutil.copy(run / "drone.toml", run / "held.toml")
    manifest.append(run / "held.toml", "identify", {"drone": [run / "held.toml"]}, {})
    for name in ("prediction", "prediction_hover", "prediction_more"):
        path = run / f"{name}.csv"
        path.write_text("policy,control,end_reason,trial,duration\npolicy_1,pwm,tilt,1,2.0\n")
        manifest.append(path, "predict", {"prediction": [path]}, {})
    (run / "empty").mkdir()
    (run / "odd.toml").write_bytes(b"\xff")
    content = page(run, tmp_path)
    told = (
        "policies: hover/; test flights: transfer_&lt;b&gt;/; predicted flights: "
        "prediction_hover.csv, prediction_more.csv; identified drones: held.toml."
    )
    assert f"not on this page: {told}" in content


def test_text_from_files_cannot_become_markup(tmp_path):
    evil = "</script><script>alert(1)</script>"
    transfer = flown(simulated=evil, reason=evil)
    content = page(
        replace(transfer, table=transfer.table.with_columns(policy=polars.lit(evil))), tmp_path
    )
    assert "alert(1)" in content
    assert "<script>alert" not in content


def test_nothing_is_loaded_from_outside(run, tmp_path):
    content = report(run, tmp_path / "page.html").read_text()
    assert "default-src 'none'" in content
    assert not re.search(
        r"<(?:script|link|img|iframe|source)[^>]*\s(?:src|href)\s*=", page(run, tmp_path)
    )
    assert not re.search(r"(?:src|href)\s*=\s*[\"']?\s*(?:https?:)?//", page(run, tmp_path))


def test_the_same_run_gives_the_same_bytes_and_they_are_few(run, tmp_path):
    assert (
        report(run, tmp_path / "1.html").read_bytes()
        == report(run, tmp_path / "2.html").read_bytes()
    )
    assert len(page(run, tmp_path)) < 1_100_000, "most of it the charts' library"


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="nothing of a run"):
        report(tmp_path, tmp_path / "page.html")
    with pytest.raises(InputError, match="no such file or folder"):
        report(tmp_path / "nowhere", tmp_path / "page.html")
    (tmp_path / "flight.bin").write_bytes(b"#ROSBAG")
    with pytest.raises(InputError, match=r"nothing of a run.* Found: a ROS 1 bag"):
        report(tmp_path, tmp_path / "page.html")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("transfer/flights.csv", "flight,policy\n1,1\n", "missing column reality"),
        (
            "transfer/flights.csv",
            polars.concat([flown().table, flown().table[:1]]).write_csv(),
            "flights.csv: 3 flight logs, but 4 rows",
        ),
        ("recorded/flight_01.csv", "# maidenflight flight 1\n0\n", "not a flight log"),
        ("validation.csv", "model,horizon\nmine,0.1\n", "missing column position"),
        ("validation_windows.csv", "# record: {\nwindow\n1\n", "holds no valid JSON"),
        (
            "policies/training.csv",
            "steps,policy,episode_return,survival,position_error\n1,1,high,1,1\n",
            "expected numbers",
        ),
    ],
)
def test_a_broken_file_is_named(run, tmp_path, name, content, message):
    (run / name).write_text(content)
    with pytest.raises(InputError, match=message):
        report(run, tmp_path / "page.html")


def test_the_sum_of_both_delays_says_which_lag_it_has(run):
    changed(run, search=Search("likelihood", -15.0, 258, 9))
    read = runs.read_run(run)
    assert read.drone is not None
    lag, late = (read.drone.estimates[name].value for name in NAMES[1:])
    assert "both ways together" not in str(parameter_section.section(read))
    ratio = Estimate(1.5, (1.4, 1.6), (1.5,), 0.0)
    estimates = {**read.drone.estimates, "spin_down_ratio": ratio}
    own = replace(read, drone=replace(read.drone, estimates=estimates))
    (told,) = re.findall(r"with the latency is ([\d.]+) ms", str(parameter_section.section(own)))
    assert 1e3 * (lag + late) < float(told) < 1e3 * (1.5 * lag + late)


def test_delays_are_drawn_of_a_posterior_and_not_of_a_replay(run, tmp_path):
    assert 'id="delays"' not in page(run, tmp_path)
    changed(run, search=Search("likelihood", -15.0, 258, 9))
    assert 'id="delays"' in page(run, tmp_path)


ALONE = {
    "identify": (
        ["drone.toml", "identification.csv"],
        "A drone identified from 2 flights, 20 s",
        ["parameters", "reproduce"],
    ),
    "train": (
        ["policies/policy_1.json", "policies/training.csv"],
        "Policies in training",
        ["training", "reproduce"],
    ),
    "transfer": (
        ["transfer/flights.csv", *(f"transfer/flight_0{n}.csv" for n in (1, 2, 3))],
        "Flights of virtual",
        ["flights", "reproduce"],
    ),
    "record": (
        ["recorded/flight_01.csv", "reality.toml"],
        "Flights of virtual",
        ["recorded", "parameters", "reproduce"],
    ),
    "validate": (["validation.csv"], "How well a drone is predicted", ["validation", "reproduce"]),
}


@pytest.mark.parametrize("stage", ALONE)
def test_the_folder_of_one_stage_makes_a_page(run, tmp_path, stage):
    files, title, sections = ALONE[stage]
    alone = tmp_path / "alone"
    for name in files:
        (alone / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(run / name, alone / name)
    list_files(alone)
    [output] = [output for verb, output, _ in ENTRIES if verb == stage]
    for source in (alone, run / output):
        content = page(source, tmp_path)
        assert title in content
        assert re.findall(r'<section id="(\w+)"', content) == sections


@pytest.mark.parametrize(("used", "words"), [("b", "held out"), ("a", "is no test")])
def test_it_is_said_whether_flights_were_held_out(run, tmp_path, used, words):
    record = json.dumps(RECORD | {"inputs": ["drone.toml sha256:0", "flight_1.csv sha256:a"]})
    (run / "validation.csv").write_text(f"# what\n# record: {record}\n{errors().write_csv()}")
    drone = run / "drone.toml"
    drone.write_text(
        drone.read_text().replace(
            "[record]\n", f'[record]\ninputs = ["flight_9.csv sha256:{used}"]\n'
        )
    )
    assert words in page(run, tmp_path)


def test_flights_recorded_beside_a_drone_are_found(run, tmp_path):
    (run / "recorded").rename(run / "flights")
    manifest.append(run / "flights", "record", {"logs": list((run / "flights").iterdir())}, RECORD)
    shutil.rmtree(run / "transfer")
    assert "recorded on virtual drone" in page(run, tmp_path)


def test_flights_are_drawn_in_the_colours_of_their_tables_control_structures(tmp_path):
    """As `paper/figure_4.py` writes them, in two realities, without logs and policies beside."""
    policies = [
        (control, f"{control}_80ms_{latency}ms/1")
        for control in ("pwm", "attitude")
        for latency in (0, 15)
    ]
    rows = [
        {"control": control, "flight": 6 * place + trial, "policy": policy, "reality": reality}
        | {
            "trial": trial,
            "duration": 2.0 * trial,
            "end_reason": "tilt" if trial < 6 else "time limit",
            "position_error": 0.01 * trial,
            "command_change": 0.05,
            "at_limits": 0.0,
        }
        for place, (reality, (control, policy)) in enumerate(
            itertools.product(("near:7", "far:7"), policies)
        )
        for trial in range(1, 7)
    ]
    folder = tmp_path / "zero_shot"
    folder.mkdir()
    table = folder / "flights.csv"
    table.write_text(
        f"# what\n# record: {json.dumps(RECORD)}\n{polars.DataFrame(rows).write_csv()}"
    )
    manifest.append(folder, "transfer", {"flights": [table]}, RECORD)
    content = page(folder, tmp_path)
    assert file(content, "flights").height == 48
    assert content.count('"title":"near:7"') == 1
    assert '"series":"green"' in content


def test_box_plots_of_policies_are_grouped_by_the_control_structures_that_their_files_say(tmp_path):
    """Policies of two trainings whose files have the same names, and one of the authors'."""
    structures = {"b/policy_1": "attitude", "a/policy_1": "pwm", "b/policy_2": "attitude"}
    for name, structure in structures.items():
        commanded = INTERFACES[structure]()
        made = untrained_policy(jax.random.key(0), commanded, PolicySpec(hidden=(3,)))
        policy_file.write_policy(tmp_path / f"{name}.json", made, {**RECORD, "seed": 3})
    theirs = untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(3,)))
    export_authors_json(theirs, tmp_path / "pwm", name="pwm_024")
    export_authors_json(theirs, tmp_path / "unknown", name="pwm_025")[0].rename(tmp_path / "x.json")
    names = [*structures, "pwm/pwm_024"]
    rows = [
        {"policy": name, "reality": "near:7", "trial": trial, "duration": trial}
        | {"end_reason": "tilt", "position_error": 0.01, "at_limits": 0.1, "command_change": 0.1}
        for name in names
        for trial in range(1, 6)
    ]
    table = polars.DataFrame(rows).with_columns(
        polars.int_range(1, len(rows) + 1).alias("flight"), polars.col("duration").cast(float)
    )
    run_folder.FLIGHTS.write(tmp_path / "flights.csv", table, RECORD)
    files = [*(tmp_path / f"{name}.json" for name in names), tmp_path / "x.json"]
    manifest.append(tmp_path / "p", "train", {"policies": files}, RECORD)
    manifest.append(tmp_path / "t", "transfer", {"flights": [tmp_path / "flights.csv"]}, RECORD)
    run = runs.read_run(tmp_path)
    assert {name: run.controls[name] for name in names} == structures | {"pwm/pwm_024": "pwm"}
    assert run.policies == 5
    assert run.records["a/policy_1.json"]["seed"] == 3
    drawn = flight_section.tested(run)
    grouped = ["b/policy_1", "b/policy_2", "a/policy_1", "pwm/pwm_024"]
    assert f'"sort":{json.dumps(grouped, separators=(",", ":"))}' in drawn
    assert all(STRUCTURES[structure] in drawn for structure in ("pwm", "attitude"))
    # Where the structure of one is not known they stand as they flew.
    manifest.append(tmp_path / "p", "train", {"policies": files[1:]}, RECORD)
    unknown = flight_section.tested(runs.read_run(tmp_path))
    assert f'"sort":{json.dumps(names, separators=(",", ":"))}' in unknown


def test_verdicts_of_a_prediction_stand_at_the_top_those_that_may_fly_first() -> None:
    verdicts = [
        {"good": good, "sentence": f"{words}: <policy_{n}>"}
        for n, (good, words) in enumerate([(False, "Do not fly"), (True, "Fly")])
    ]
    run = runs.Run(policies=2, records={"prediction.csv": {"verdicts": verdicts}})
    head = page_module.to_html(run).partition("<nav")[0]
    said = re.findall(r'<p class="verdict( good)?">(.*?)</p>', head)
    assert said == [(" good", "Fly: &lt;policy_1&gt;"), ("", "Do not fly: &lt;policy_0&gt;")]


@pytest.mark.parametrize("reached", [True, False])
def test_a_position_error_is_a_key_figure_of_flights_to_the_time_limit_alone(reached) -> None:
    table = flown().table.with_columns(end_reason=polars.lit("time limit" if reached else "tilt"))
    labels = [one.label for one in head_section.key_figures(runs.Run(table=table))]
    assert any("position error" in label for label in labels) == reached


def test_predicted_flights_have_their_own_section(tmp_path):
    rows = [
        {"policy": name, "control": name, "trial": trial, "duration": trial, "end_reason": "tilt"}
        for name in ("pwm", "attitude")
        for trial in range(1, 6)
    ]
    (tmp_path / "prediction.csv").write_text(
        f"# what\n# record: {json.dumps(RECORD)}\n{polars.DataFrame(rows).write_csv()}"
    )
    content = page(None, tmp_path, prediction=tmp_path / "prediction.csv")
    assert 'id="predicted-times"' in content
    assert file(content, "prediction")["mean"].to_list() == [3.0, 3.0]


def test_identified_parameters_stand_beside_the_papers(run, tmp_path):
    table = file(page(run, tmp_path), "estimates")
    [paper] = table.filter(parameter="motor_time_constant")["paper"]
    assert paper == pytest.approx(0.088)


def test_flights_are_packed_within_a_step_of_what_they_were(run, tmp_path):
    [logs] = re.findall(r'id="logs">(.*?)</script>', page(run, tmp_path))
    packed, whole = json.loads(logs)["flights"][2], circling(10.0)
    levels = np.frombuffer(base64.b64decode(packed["rows"]), "<i2").reshape(10, -1)
    columns = np.array(packed["middle"])[:, None] + levels * np.array(packed["step"])[:, None]
    np.testing.assert_allclose(columns[:3].T, whole.position[::2], atol=2e-5)
    np.testing.assert_allclose(columns[6:].T, whole.command[::2], atol=2e-5)


def browsed(made, tmp_path, wishes, *more) -> str:
    """The page's DOM once it has been open for three seconds of its own time; its console must stay
    empty."""
    quiet = (
        "--disable-quic --no-first-run --disable-background-networking "
        "--disable-component-update --disable-sync"
    )
    shown = subprocess.run(
        [
            *(str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", *quiet.split()),
            f"--user-data-dir={tmp_path / 'profile'}",
            *("--enable-logging=stderr", "--v=0", *more),
            *("--dump-dom", f"{made.as_uri()}#{wishes}"),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        env=environ | {"HOME": str(tmp_path)},
    )
    assert [line for line in shown.stderr.splitlines() if "CONSOLE" in line] == []
    return shown.stdout


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
@pytest.mark.slow
def test_in_a_browser_the_drone_moves_and_tables_sort(run, tmp_path):
    made = report(run, tmp_path / "page.html")
    made.write_text(
        made.read_text()
        + "<script>document.querySelector('a[download=\"flights.csv\"]').click()</script>"
    )
    dom = browsed(
        made,
        tmp_path,
        "autoplay&sort=flights.position_error&sort=estimates.value&theme=dark",
        "--virtual-time-budget=3000",
    )
    assert polars.read_csv(tmp_path / "Downloads" / "flights.csv")["duration"].to_list() == [
        2.0,
        0.5,
        10.0,
    ]
    assert '<html lang="en" data-theme="dark">' in dom
    time = float(re.findall(r'data-time="([\d.]+)"', dom)[-1])
    place = [float(number) for number in re.findall(r'data-position="([^"]+)"', dom)[-1].split()]
    assert time > 0
    angle = 2 * np.pi * min(time, 1.98) / 3  # the last row of the viewer
    np.testing.assert_allclose(
        place, [0.25 * np.cos(angle), 0.25 * np.sin(angle), 1.01], atol=0.003
    )
    assert re.findall(r'<tr data-flight="(\d)"', dom) == ["0", "2", "1"], (
        "smallest error first, unknown last"
    )
    assert dom.count('aria-sort="ascending"') == 2
    values = re.search(r'class="sortable estimates">.*?<tbody>(.*?)</tbody>', dom, re.DOTALL)
    assert values
    assert re.findall(r'<tr><th scope="row" data-value="(\w+)"', values[1]) == [
        "latency",
        "motor_time_constant",
        "thrust_to_weight",
    ]


_ALL = """
<script>{
figures.forEach(drawFigure);
document.querySelector("#horizons .entry").click();
const learning = document.querySelector("#learning");
learning.querySelector(".files .button").click();
const plan = JSON.parse(learning.querySelector("script").textContent);
asFile(learning, plan, "png").then(png => { learning.dataset.png = png.slice(0, 40); });
const [drawn] = drawings.get(document.querySelector("#horizons"));
const marks = drawn.scenegraph().root.items[0].items;
const dot = marks.find(mark => mark.items[0] && mark.items[0].tooltip).items[0];
tell(null, {clientX: 5, clientY: 5}, null, dot.tooltip);
}</script>
"""


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
@pytest.mark.slow
def test_in_a_browser_charts_are_drawn_told_hidden_and_saved(run, tmp_path):
    made = report(run, tmp_path / "page.html")
    made.write_text(made.read_text() + _ALL)
    dom = browsed(made, tmp_path, "theme=dark", "--virtual-time-budget=8000")
    for name, panels in (("estimates", 1), ("corner", 1), ("horizons", 4)):
        [figure] = re.findall(rf'<figure class="chart" id="{name}">.*?</figure>', dom, re.DOTALL)
        assert figure.count('class="marks"') == panels
        assert "NaN" not in figure.replace('"NaN"', "")
    [figure] = re.findall(r'<figure class="chart" id="horizons">.*?</figure>', dom, re.DOTALL)
    assert re.findall(r'aria-pressed="(\w+)"', figure) == ["false", "true"]
    assert "--orange" not in figure[figure.index('class="panels"') :], "hidden, and so not drawn"
    assert "--soft" in figure
    assert re.search(r'<div id="tip"[^>]*>.*<span>position \[cm\]</span><b>20</b>', dom)
    saved = (tmp_path / "Downloads" / "learning.svg").read_text()
    assert len(re.findall("<svg", saved)) == 4
    assert "var(--" not in saved
    assert "#14171b" in saved, "in the dark colours that it has on the page"
    assert 'data-png="data:image/png;base64,iVBORw0KGgo' in dom


def test_the_charts_library_is_that_of_its_packages():
    folder = Path(page_module.__file__).parent / "vega"
    said = (folder / "README.md").read_text()
    told = dict(re.findall(r"^\| `([\w.-]+)` .*`([0-9a-f]{64})` \|$", said, re.MULTILINE))
    files = {path.name for path in folder.glob("*.js")}
    assert files == told.keys()
    for name, digest in told.items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    assert "BSD" in said
    assert not any("</script" in script for script in page_module.vega())


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
@pytest.mark.slow
def test_in_a_browser_a_click_on_a_dot_shows_its_flight(tmp_path):
    for number, seconds in enumerate((2.0, 3.0, 1.0), 1):
        flight_csv.write(
            tmp_path / "logs" / f"flight_{number}.csv", circling(seconds, simulated="")
        )
    made = report(None, tmp_path / "page.html", logs=tmp_path / "logs")
    click = """<script>
figures.forEach(drawFigure);
setTimeout(() => {
  const [, dot] = document.querySelectorAll("#trims .mark-symbol path");
  dot.dispatchEvent(new MouseEvent("click", {bubbles: true}));
}, 1000);
</script>"""
    made.write_text(made.read_text() + click)
    dom = browsed(made, tmp_path, "", "--virtual-time-budget=4000")
    assert re.findall(r'<tr data-flight="(\d)" class="chosen"', dom) == ["1"]
    [trims] = re.findall(r'<figure class="chart" id="trims">.*?</figure>', dom, re.DOTALL)
    assert trims.count('class="marks"') == 2, "without a drone hover command and battery"


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_243_flights_are_drawn_by_a_page_of_less_than_six_megabytes(tmp_path):
    one = circling(20.0)
    rows = {
        "policy": "1",
        "reality": "virtual:1",
        "trial": 1,
        "duration": 20.0,
        "end_reason": "time limit",
        "position_error": 0.01,
        "command_change": 0.02,
        "at_limits": 0.0,
    }
    table = polars.DataFrame([{"flight": number, **rows} for number in range(1, 244)])
    made = report(Transfer(table, (one,) * 243), tmp_path / "page.html")
    assert made.stat().st_size < 6e6
    assert re.findall(r'data-drawn="\d+"', browsed(made, tmp_path, "", "--timeout=60000"))


def test_a_name_that_is_no_utf8_is_shown_by_its_bytes() -> None:
    run = runs.Run(policies=1, records={"policies/\udcff.json": {"seed": 1}})
    assert r"policies/\udcff.json" in page_module.to_html(run).encode().decode()


def beside(run_folder_: Path) -> dict[str, runs.Run]:
    """A run, and another of a drone whose lag is 3 standard errors of the difference longer."""
    first = runs.read_run(run_folder_)
    assert first.drone is not None
    lag = first.drone.estimates["motor_time_constant"]
    error = (lag.interval[1] - lag.interval[0]) / 3.92
    shift = 3 * 2**0.5 * error
    longer = replace(
        lag, value=lag.value + shift, interval=tuple(end + shift for end in lag.interval)
    )
    estimates = {**first.drone.estimates, "motor_time_constant": longer}
    drone = dataclasses.replace(first.drone, estimates=estimates)
    return {"a": first, "b": replace(first, drone=drone, policies=0)}


def test_two_runs_are_compared_in_standard_errors_of_their_difference(run):
    content = str(comparison.parameters(beside(run)))
    apart = dict(file(content, "parameters").select("parameter", "apart").iter_rows())
    assert apart["motor time constant [ms]"] == pytest.approx(3.0, rel=1e-6)
    assert apart["thrust-to-weight ratio"] == pytest.approx(0.0, abs=1e-9)


def test_key_figures_of_two_runs_have_differences_and_learning_curves_lie_over_each_other(run):
    some = beside(run)
    rows = file(str(comparison.key_figures(some)), "figures")
    apart = dict(rows.select("figure", "difference").iter_rows())
    [lag] = [one for name, one in apart.items() if name.startswith("motor time constant")]
    assert float(lag.replace("\N{MINUS SIGN}", "-").split()[0]) != 0.0
    assert lag.endswith(" ms")
    some["b"] = replace(some["b"], training=some["a"].training)
    content = str(comparison.trained(some))
    assert 'id="compared-training"' in content
    assert comparison.trained({"a": some["a"]}) == ""


def test_test_flights_of_two_runs_have_a_row_each(run):
    rows = file(str(comparison.tested(beside(run))), "flown")
    assert rows["run"].to_list() == ["a", "b"]
    assert rows["reached"].to_list() == pytest.approx([1 / 3, 1 / 3])
    assert rows["duration"].to_list() == [2.0, 2.0]


def test_a_run_without_what_another_has_is_compared_by_the_rest(run):
    some = beside(run)
    some["b"] = replace(some["b"], table=None, drone=None)
    assert comparison.parameters(some) == ""
    assert file(str(comparison.tested(some)), "flown")["run"].to_list() == ["a"]
    assert set(file(str(comparison.key_figures(some)), "figures").columns) == {
        *("figure", "a", "b", "difference")
    }


def test_what_two_drones_rest_on_stands_beside_each_other(run):
    some = beside(run)
    drone = some["b"].drone
    assert drone is not None
    doubt = LogWarning("identification", "", "the log does not name its battery law")
    heavy = parameters.replace(drone.parameters, mass=0.037)
    wide = replace(drone.estimates["latency"], interval=(0.002, 0.034))
    estimates = {**drone.estimates, "latency": wide}
    unidentified = {"drag_z": (0.0, 0.5)}
    drone = replace(drone, parameters=heavy, warnings=(doubt,), estimates=estimates)
    some["b"] = replace(some["b"], drone=replace(drone, unidentified=unidentified))
    assert "b (37 g): " in comparison.summarize(some)
    content = str(comparison.key_figures(some))
    figures = {row["figure"]: row for row in file(content, "figures").iter_rows(named=True)}
    assert (figures["mass"]["b"], figures["mass"]["difference"]) == ("37 g", "+9 g")
    assert doubt.cause in content.partition("<h3>b</h3>")[2]
    rows = file(str(comparison.parameters(some)), "parameters").to_dicts()
    texts = {row["parameter"]: row for row in rows}
    assert texts["drag z [1/s]"]["a"] == "\N{EN DASH}"
    assert texts["drag z [1/s]"]["b"] == "not identified, plausible [0.00, 0.50]"
    assert texts["latency [ms]"]["a"] == "18.00 [17.82, 18.18]"
    assert texts["latency [ms]"]["b"] == "18.0 [2.0, 34.0]", "a decimal more than it justifies"


def test_a_drone_file_without_a_run_makes_a_page_and_several_are_compared(run, tmp_path):
    places = [tmp_path / name / "drone.toml" for name in ("thick", "thin")]
    for place in places:
        place.parent.mkdir()
        shutil.copy(run / "drone.toml", place)
    page = page_module.report(places[0].parent, tmp_path / "one.html")
    assert page.read_text() == report(places[0], tmp_path / "two.html").read_text()
    made = Report(drone=tuple(places)).run(tmp_path / "both.html").value.read_text()
    assert "<title>thick beside thin</title>" in made
    named = Report(runs=(Path(f"old={run}"), places[1])).run(tmp_path / "named.html").value
    assert "<title>old beside " in named.read_text()
    for wrong in (Report(runs=(run,), drone=tuple(places)), Report(runs=(run, Path("nowhere")))):
        with pytest.raises(InputError):
            wrong.run(tmp_path / "wrong.html")


def test_runs_of_one_name_are_told_apart_by_their_folders(run, tmp_path):
    for day in ("monday", "tuesday"):
        shutil.copytree(run, tmp_path / day / "run")
    places = [tmp_path / day / "run" for day in ("monday", "tuesday")]
    content = report_comparison(places, tmp_path / "both.html").read_text()
    assert "<title>monday/run beside tuesday/run</title>" in content
    with pytest.raises(InputError):
        report_comparison([places[0], places[0]], tmp_path / "both.html")
