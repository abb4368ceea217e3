"""Names of files that are no UTF-8, and terminals that are not, stop no command."""

import os
import sys
from io import BytesIO, TextIOWrapper
from pathlib import Path

import jax
import pytest

from commands import Command
from made_flights import driven
from maidenflight import cli, inputs, parameters, policy, policy_file, results
from maidenflight.flights import flight_csv
from maidenflight.simulator.policy_spec import PolicySpec

ODD = os.fsdecode(b"fl\xe9ge\xff")
"""A name as it is written in Latin-1, which is no UTF-8."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs, policies and a drone with names that are no UTF-8."""
    place = tmp_path_factory.mktemp("files") / ODD
    flight_csv.write(place / "logs" / f"{ODD}.csv", driven(600))
    own = policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(3,)))
    policy_file.write_policy(place / "policies" / f"{ODD}.json", own, {"seed": 1})
    parameters.write_drone(place / f"{ODD}.toml", parameters.crazyflie())
    return place


COMMANDS = {
    "log": ["log", "{}/logs", "-o", "{}/out/log"],
    "identify": [
        *("identify", "{}/logs", "--start", "{}/ODD.toml", "--over", "latency", "--trials", "1"),
        *("--evaluations", "11", "-o", "{}/out/ODD.toml"),
    ],
    "drone": ["drone", "{}/ODD.toml", "-o", "{}/out/drone_ODD.toml"],
    "transfer": [
        *("transfer", "{}/policies", "--drone", "{}/ODD.toml", "--trials", "1"),
        *("--duration", "0.1", "-o", "{}/out/flown"),
    ],
    "export": ["export", "{}/policies/ODD.json", "-o", "{}/out/c"],
    "report of logs": ["report", "--logs", "{}/logs", "-o", "{}/out/logs.html"],
    "report of policies": ["report", "--policies", "{}/policies", "-o", "{}/out/ODD.html"],
}


SLOW = [pytest.param(one, marks=pytest.mark.slow) for one in ("identify", "transfer")]


@pytest.mark.parametrize(
    "name", [*(one for one in COMMANDS if one not in ("identify", "transfer")), *SLOW]
)
def test_names_that_are_no_utf_8_are_taken_and_files_stay_utf_8(
    name: str, folder: Path, command: Command
) -> None:
    words = [word.format(folder).replace("ODD", ODD) for word in COMMANDS[name]]
    code, _, err = command(words, ["--overwrite"])
    assert (code, "Traceback" in err) == (0, False), err
    for path in (folder / "out").rglob("*"):
        if path.is_file() and path.suffix in (".toml", ".json", ".csv", ".html"):
            text = path.read_bytes().decode("utf-8")
            if path.suffix == ".toml":
                inputs.from_toml(text)


def test_a_record_holds_codes_in_place_of_bytes_that_are_no_text(tmp_path: Path) -> None:
    path = tmp_path / ODD
    path.write_text("")
    record = results.record(seed=1, inputs=[path], settings={"files": [ODD], "more": {"a": ODD}})
    assert record["inputs"][0].startswith("fl\\udce9ge\\udcff sha256:")
    assert record["settings"] == {
        "files": ["fl\\udce9ge\\udcff"],
        "more": {"a": "fl\\udce9ge\\udcff"},
    }


@pytest.mark.parametrize("encoding", ["latin-1", "ascii", "cp1252", "utf-8"])
def test_output_in_any_encoding(
    encoding: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python opens its streams in a terminal's encoding, and strict, as here."""
    written = {name: BytesIO() for name in ("stdout", "stderr")}
    for name, to in written.items():
        monkeypatch.setattr(sys, name, TextIOWrapper(to, encoding=encoding, write_through=True))
    monkeypatch.setattr(sys, "argv", ["maidenflight", "log", str(folder / "logs")])
    cli.main()
    assert b"Traceback" not in written["stderr"].getvalue()
    said = written["stdout"].getvalue().decode(encoding)
    assert "1 file" in said
    assert "fl\\udce9ge\\udcff" in said
