"""`Doctor` says what a machine has and what is missing."""

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from commands import Command
from maidenflight.verbs import doctor


def test_a_whole_machine_passes_and_the_findings_are_written(
    tmp_path: Path, command: Command
) -> None:
    code, out, _ = command(f"doctor -o {tmp_path}/doctor.json --json")
    findings = {one["name"]: one for one in json.loads(out)["findings"]}
    assert code == 0
    assert findings["this folder"]["value"] == "writable"
    assert "cores" in findings["processor"]["value"]
    assert json.loads((tmp_path / "doctor.json").read_text()) == list(findings.values())


def test_a_full_disk_and_a_missing_package_are_named(
    monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    version: Callable[[str], Any] = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "cflib" else version(name))
    monkeypatch.setattr(doctor, "disk_usage", lambda _: SimpleNamespace(free=5e6))
    code, out, err = command("doctor")
    assert code == 2
    assert "drone (cflib)" in " ".join(out.split())
    assert "disk: see the table" in err


def test_a_radio_without_permission_is_told_from_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "_USB", tmp_path)
    assert doctor._radio().value == "none plugged in"
    (tmp_path / "1-1").mkdir()
    numbers = {"idVendor": "1915", "idProduct": "7777", "busnum": "9", "devnum": "77"}
    for name, number in numbers.items():
        (tmp_path / "1-1" / name).write_text(f"{number}\n")
    radio = doctor._radio()
    assert radio.value == "/dev/bus/usb/009/077"
    assert "udev" in radio.cure
