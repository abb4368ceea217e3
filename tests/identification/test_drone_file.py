"""Drone files: what is written is read back, and what is damaged is refused by name."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from maidenflight import cli, manifest, names, parameters, policy, policy_file
from maidenflight.errors import InputError
from maidenflight.experiments.drones import choose_prediction, find_reality, possible_drones
from maidenflight.flights.checkup.result import LogWarning
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import (
    SAVED,
    Advice,
    DroneFile,
    Estimate,
    GroupGain,
    Search,
    Source,
)
from maidenflight.identification.posterior import Posterior
from maidenflight.parameters import QUANTITIES, crazyflie
from maidenflight.reporting.figures.plots import Picture
from maidenflight.reporting.page import report
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.verbs.train import Train

WHOLE = DroneFile(
    crazyflie(),
    {
        "latency": Estimate(
            0.018, (0.01, 0.02), (0.018, 0.019), 0.002, None, (0.0, 0.05), (0.0, 0.03)
        ),
        "torque_bias_x": Estimate(1e-5, (0.0, 2e-5), (1e-5,), 3e-6, (-1e-5, 3e-5)),
    },
    Posterior(
        {
            "latency": np.array([0.018, 0.019]),
            "torque_bias_x": np.array([1e-5, 0.0]),
            "inertia_z": np.array([2e-5, 3e-5]),
        }
    ),
    Source(4, 120.0, True, "subsampled", 65535.0),
    Search("likelihood", -15.4, 116, 3),
    (
        GroupGain("drag", 0.098, 0.0054, True),
        GroupGain("torque_bias", -1e-5, None, False, "no gain"),
    ),
    {"inertia_z": (1.8e-5, 3.9e-5)},
    {"version": "0.1.0", "seed": 7, "inputs": ["flight_01.csv sha256:ab12"], "settings": {}},
    advice=(
        Advice("latency", "log rotor speeds", (0.017, 0.019)),
        Advice("inertia_z", "yaw to and fro", None),
    ),
    warnings=(
        LogWarning("thrust curve", "one.csv", "It is curved.", "Look.", 0.5, "0.58 .. 1.35", True),
        LogWarning("identification", "", "The interval is too narrow."),
    ),
)
TEXT = WHOLE.to_toml("mine")


def same(one: DroneFile, other: DroneFile) -> None:
    for name in QUANTITIES:
        np.testing.assert_array_equal(
            getattr(one.parameters, name), getattr(other.parameters, name)
        )
    assert list(one.posterior) == list(other.posterior)
    for name, values in one.posterior.items():
        np.testing.assert_allclose(values, other.posterior[name], rtol=1e-5)
    rest = ("estimates", "source", "search", "gains", "unidentified", "record", "advice")
    rest += ("warnings",)
    assert [getattr(one, name) for name in rest] == [getattr(other, name) for name in rest]


def test_a_file_reads_back_as_it_was_written(tmp_path):
    path = WHOLE.write(tmp_path / "mine.toml")
    assert path.read_text() == TEXT
    same(drone_file.read(path), WHOLE)
    assert drone_file.read(path).to_toml("mine") == TEXT
    # Files before the field had this name.
    path.write_text(TEXT.replace("is_in_model", "kept"))
    same(drone_file.read(path), WHOLE)


def test_a_plain_drone_and_a_named_one_were_not_identified(tmp_path):
    for file in (
        drone_file.read("crazyflie"),
        drone_file.read(DroneFile(crazyflie()).write(tmp_path / "plain.toml")),
    ):
        same(file, DroneFile(crazyflie()))


def test_a_file_holds_some_of_many_samples(tmp_path):
    many = dataclasses.replace(WHOLE, posterior={"latency": np.linspace(0.01, 0.02, 3 * SAVED)})
    found = drone_file.read(many.write(tmp_path / "mine.toml")).posterior["latency"]
    np.testing.assert_allclose(found, many.posterior["latency"][:SAVED], rtol=1e-5)


def swapped(pattern: str, by: str) -> str:
    found, count = re.subn(pattern, by, TEXT, count=1, flags=re.MULTILINE | re.DOTALL)
    assert count == 1, pattern
    return found


def without(table: str) -> str:
    """The text without a table and those in it."""
    return re.sub(
        rf"\[+{re.escape(table)}[\].].*?(?=\n\[(?!{re.escape(table)})|\Z)",
        "",
        TEXT,
        flags=re.DOTALL,
    )


DAMAGED = {
    "truncated in a number": TEXT[: TEXT.index("interval") + 12],
    "truncated in a table": TEXT[: TEXT.index("[identification.source]") + 5],
    "no text": "\x00\x01",
    "empty": "",
    "identification = 3": without("identification").replace(
        "name = ", "identification = 3\nname = ", 1
    ),
    "record = 3": without("record").replace("name = ", "record = 3\nname = ", 1),
    "posterior = 3": without("posterior").replace("name = ", "posterior = 3\nname = ", 1),
    "no source": without("identification.source"),
    "no estimates": without("identification.estimates"),
    "value is a text": swapped(r"^value = 0\.018", 'value = "0.018"'),
    "value is true": swapped(r"^value = 0\.018", "value = true"),
    "value is nan": swapped(r"^value = 0\.018", "value = nan"),
    "value is infinite": swapped(r"^value = 0\.018", "value = inf"),
    "value is huge": swapped(r"^value = 0\.018", f"value = 1{'0' * 400}"),
    "no value": swapped(r"^value = 0\.018\n", ""),
    "an interval upside down": swapped(r"^interval = \[0\.01, 0\.02\]", "interval = [0.02, 0.01]"),
    "an interval of one": swapped(r"^interval = \[0\.01, 0\.02\]", "interval = [0.02]"),
    "an interval is a number": swapped(r"^interval = \[0\.01, 0\.02\]", "interval = 0.02"),
    "a range of no parameter": swapped(r"^inertia_z = \[", "inertia_w = ["),
    "a range upside down": swapped(r"^inertia_z = \[.*?\]", "inertia_z = [2.0, 1.0]"),
    "no trials": swapped(r"^trials = \[0\.018, 0\.019\]", "trials = []"),
    "bounds upside down": swapped(r"^bounds = \[0\.0, 0\.05\]", "bounds = [0.05, 0.0]"),
    "bounds are a number": swapped(r"^bounds = \[0\.0, 0\.05\]", "bounds = 0.05"),
    "a deviation below zero": swapped(r"^between_sd = 0\.002", "between_sd = -1.0"),
    "a misspelt entry": swapped(r"^between_sd", "betwen_sd"),
    "an entry too many": swapped(r"^value = 0\.018", "value = 0.018\nspread = 1.0"),
    "an unknown parameter": swapped(r"estimates\.latency\]", "estimates.k_F]"),
    "an estimate is a number": swapped(
        r"^\[identification\.estimates\.latency\].*?(?=\n\[)",
        "[identification.estimates]\nlatency = 3",
    ),
    "no flights": swapped(r"^flights = 4", "flights = 0"),
    "half a flight": swapped(r"^flights = 4", "flights = 4.5"),
    "seconds before the start": swapped(r"^seconds = 120\.0", "seconds = -1.0"),
    "seconds are nan": swapped(r"^seconds = 120\.0", "seconds = nan"),
    "simulated is a number": swapped(r"^simulated = true", "simulated = 1"),
    "unknown commands": swapped(r'^commands = "subsampled"', 'commands = "all"'),
    "commands are a list": swapped(r'^commands = "subsampled"', 'commands = ["subsampled"]'),
    "too many counts": swapped(r"^full_scale_counts = 65535\.0", "full_scale_counts = 1e9"),
    "counts are a text": swapped(r"^full_scale_counts = 65535\.0", 'full_scale_counts = "all"'),
    "an unknown objective": swapped(r'^objective = "likelihood"', 'objective = "guess"'),
    "gains are a number": swapped(
        r"^\[\[identification\.gains\]\].*?(?=\n\[posterior)", ""
    ).replace("[identification]\n", "[identification]\ngains = 3\n"),
    "a gain is infinite": swapped(r"^log_likelihood_gain = 0\.098", "log_likelihood_gain = -inf"),
    "is_in_model is a text": swapped(r"^is_in_model = true", 'is_in_model = "yes"'),
    "samples of an unknown parameter": swapped(r'^names = \["latency"', 'names = ["speed"'),
    "samples of one parameter twice": swapped(
        r'^names = \["latency", "torque_bias_x"', 'names = ["latency", "latency"'
    ),
    "names are a text": swapped(r"^names = \[.*?\]", 'names = "latency"'),
    "samples of unequal length": swapped(r"^samples = \[\[0\.018, ", "samples = [["),
    "a sample is nan": swapped(r"^samples = \[\[0\.018, ", "samples = [[nan, "),
    "no samples": swapped(r"^samples = \[\[.*?\]\]", "samples = []"),
    "samples are a number": swapped(r"^samples = \[\[.*?\]\]", "samples = 3"),
    "inputs are numbers": swapped(r"^inputs = \[.*?\]", "inputs = [3]"),
    "inputs have no digest": swapped(r"^inputs = \[.*?\]", 'inputs = ["flight_01.csv"]'),
    "another format": swapped(r"^format = 7", "format = 4"),
    "mass is a text": swapped(r"^mass = 0\.028", 'mass = "light"'),
    "mass is nan": swapped(r"^mass = 0\.028", "mass = nan"),
}


@pytest.fixture(params=DAMAGED)
def damaged(request, tmp_path):
    path = tmp_path / "drone.toml"
    path.write_text(DAMAGED[request.param])
    return path


def test_a_damaged_file_is_refused_by_its_name(damaged):
    with pytest.raises(InputError, match=re.escape(str(damaged))):
        drone_file.read(damaged)


def test_a_file_that_is_no_text_or_not_there_is_refused(tmp_path):
    (tmp_path / "drone.toml").write_bytes(b"\xff\xfe\xff")
    for path in (tmp_path / "drone.toml", tmp_path / "none.toml", tmp_path):
        with pytest.raises(InputError, match=re.escape(str(path))):
            drone_file.read(path)


def test_a_report_of_a_damaged_file_is_refused(damaged, tmp_path):
    with pytest.raises(InputError, match=re.escape(str(damaged))):
        report(None, tmp_path / "report.html", drone=damaged)
    manifest.append(damaged, "identify", {"drone": [damaged]}, {})
    with pytest.raises(InputError, match=re.escape(str(damaged))):
        report(tmp_path, tmp_path / "report.html")


def test_a_policy_is_neither_trained_nor_predicted_for_a_damaged_file(damaged, tmp_path):
    for randomization in (0.1, names.POSTERIOR, names.WIDE):
        with pytest.raises(InputError, match=re.escape(str(damaged))):
            Train(drone=str(damaged), policies=1, randomize=randomization).run(tmp_path / "made")
    for randomization in (0.0, names.POSTERIOR, names.TRIMS):
        with pytest.raises(InputError, match=re.escape(str(damaged))):
            possible_drones(damaged, randomization, 0)
    with pytest.raises(InputError, match=re.escape(str(damaged))):
        choose_prediction(damaged)


@pytest.fixture(scope="module")
def policies(tmp_path_factory):
    folder = tmp_path_factory.mktemp("policies")
    policy_file.write_policy(
        folder / "policy_1.json",
        policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(3,))),
    )
    return folder


@pytest.mark.parametrize("which", ["truncated in a number", "identification = 3", "mass is nan"])
@pytest.mark.parametrize(
    "command",
    [
        "predict {policies} --drone {drone} -o {made}.csv",
        "train --drone {drone} -o {made}",
        "report {folder}",
        "report --drone {drone} -o {made}.html",
        "validate {drone} {folder} -o {made}.csv",
    ],
)
def test_a_command_ends_with_one_line_and_2(
    command: str, which: str, policies: Any, tmp_path: Any, monkeypatch: Any, capsys: Any
) -> None:
    drone = tmp_path / "drone.toml"
    drone.write_text(DAMAGED[which])
    manifest.append(drone, "identify", {"drone": [drone]}, {})
    given = {"policies": policies, "drone": drone, "made": tmp_path / "made", "folder": tmp_path}
    monkeypatch.setattr(
        "sys.argv", ["maidenflight", *(word.format(**given) for word in command.split())]
    )
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    err = capsys.readouterr().err.splitlines()
    assert len(err) == 1
    assert str(drone) in err[0]


@pytest.mark.parametrize("which", ["truncated in a number", "mass is nan", "no text"])
def test_a_reality_of_a_damaged_file_is_refused(which, tmp_path):
    drone = tmp_path / "drone.toml"
    drone.write_text(DAMAGED[which])
    with pytest.raises(InputError, match=re.escape(str(drone))):
        find_reality(str(drone))


def test_what_parameters_alone_read_is_the_same_drone(tmp_path):
    path = WHOLE.write(tmp_path / "mine.toml")
    found = parameters.read_drone(path)
    for name in QUANTITIES:
        np.testing.assert_array_equal(getattr(found, name), getattr(WHOLE.parameters, name))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"inertia": [0.133, 0.133, 0.264]}, "radius of gyration"),
        ({"mass": 2.8}, "radius of gyration"),
        ({"rotor_x": 10 * crazyflie().rotor_x, "rotor_y": 10 * crazyflie().rotor_y}, "gyration"),
        ({"inertia": [1.3e-5, 1.3e-5, 3.5e-5]}, "inertia_z 3.5e-05 kg m2 is larger"),
    ],
)
def test_a_body_that_cannot_be_is_refused(
    changes: dict[str, Any], named: str, tmp_path: Path
) -> None:
    drone = parameters.replace(
        crazyflie(), **{name: np.asarray(value, np.float32) for name, value in changes.items()}
    )
    path = DroneFile(drone).write(tmp_path / "mine.toml")
    with pytest.raises(InputError, match=named):
        drone_file.read(path)


def test_a_drone_file_shows_itself_and_draws_drones_to_train_over():
    drones = WHOLE.ensemble
    np.testing.assert_allclose(drones.drones.latency, [0.018, 0.019], rtol=1e-6)
    assert np.asarray(drones.drones.mass).tolist() == [float(crazyflie().mass)] * 2
    assert isinstance(WHOLE.plot(), Picture)
    with pytest.raises(InputError):
        _ = DroneFile(crazyflie()).ensemble
