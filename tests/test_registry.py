"""Names are known without imports; installed packages add to them by entry points."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import maidenflight as mf
from commands import run
from made_flights import calm
from maidenflight import policy, policy_file, registry
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv
from maidenflight.flights.reading import read_flights

PACKAGE = '''
import json
from dataclasses import replace
from pathlib import Path

from maidenflight.flights import flight_csv
from maidenflight.flights.formats import Recording, TableFormat
from maidenflight.settings import setting, whole
from maidenflight.simulator.realities.virtual_drone import virtual_drone
from maidenflight.verb import Output, Result, Verb


def flights(table):
    frame = table.frame.rename(lambda name: name.removeprefix("acme_"))
    return flight_csv.flights(replace(table, frame=frame, mark=flight_csv.MARK))


def packets(path, name):
    flight = flight_csv.from_csv(path.read_bytes()[4:].decode(), name)
    return [(flight, [row * flight.period for row in range(len(flight))])], []


TABLE = TableFormat("the acme's table", lambda one: "acme_time" in one.frame.columns, flights)
PACKETS = Recording("the acme's packets", (".acme",), b"ACME", packets)


def drone(text):
    return replace(virtual_drone(int(text)), name=f"acme-{text}")


def write(policy, folder, *, name="policy"):
    path = Path(folder) / f"{name}.acme"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(policy.interface.to_dict()))
    return [path]


class Count(Verb):
    """Count to TEN."""

    output = Output(None, "Nothing.")
    last: int = setting(whole(1, 10), 10, "Where to end.")

    def compute(self, output, progress):
        return Result({"last": self.last})
'''
ENTRIES = """
[maidenflight.log_formats]
acme = acme:TABLE
acme-packets = acme:PACKETS
[maidenflight.realities]
acme = acme:drone
[maidenflight.exporters]
acme = acme:write
[maidenflight.verbs]
count = acme:Count
"""


def install(folder: Path, entries: str, name: str = "acme-drones", module: str = PACKAGE) -> None:
    """A package as an installer leaves it."""
    home = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    home.mkdir(parents=True)
    (home / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (home / "entry_points.txt").write_text(entries)
    (folder / f"{name.partition('-')[0]}.py").write_text(module)


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which Python finds packages."""
    folder = tmp_path / "packages"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "acme", raising=False)
    return folder


def test_a_log_format_of_an_installed_package_is_read(
    packages: Path, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    install(packages, ENTRIES)
    logs = tmp_path / "logs"
    logs.mkdir()
    text = flight_csv.to_csv(calm())
    head, _, rows = text.partition("\ntime,")
    names, _, rows = rows.partition("\n")
    theirs = ",".join(f"acme_{name}" for name in ["time", *names.split(",")])
    (logs / "flight.csv").write_text(
        f"{head.replace(flight_csv.MARK, '# of acme')}\n{theirs}\n{rows}"
    )
    (logs / "packets.acme").write_bytes(b"ACME" + text.encode())
    code, out, _ = run(monkeypatch, capsys, "log", logs, "--json")
    assert code == 0
    assert len(json.loads(out)["logs"]) == 1  # both hold the same flight
    for name in ("flight.csv", "packets.acme"):
        (flight,) = read_flights(logs / name)
        np.testing.assert_array_equal(flight.position, flight_csv.from_csv(text, "own").position)


@pytest.mark.slow
def test_a_reality_of_an_installed_package_is_flown(
    packages: Path, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    install(packages, ENTRIES)
    file = policy_file.write_policy(
        tmp_path / "policy_1.json", policy.untrained_policy(jax.random.key(0))
    )
    words = ("--reality", "acme:3+10ms", "--trials", 1, "--duration", 1, "-o", tmp_path / "flown")
    code, _, _ = run(monkeypatch, capsys, "transfer", file, *words)
    assert code == 0
    assert "acme-3+10ms" in (tmp_path / "flown" / "flights.csv").read_text()
    with pytest.raises(InputError, match="Did you mean acme:3"):
        mf.reality("acne:3")


def test_an_exporter_of_an_installed_package_is_used(
    packages: Path, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    install(packages, ENTRIES)
    made = policy.untrained_policy(jax.random.key(0))
    file = policy_file.write_policy(tmp_path / "policy_1.json", made)
    monkeypatch.chdir(tmp_path)
    code, _, _ = run(monkeypatch, capsys, "export", file, "--to", "acme")
    assert code == 0
    assert json.loads(Path("acme_policy/policy_1.acme").read_text())["name"] == "pwm"
    with pytest.raises(InputError, match=r"'acne': no such exporter. .* c, .*px4, acme\."):
        mf.export(made, tmp_path, "acne")


def test_a_verb_of_an_installed_package_is_a_command(
    packages: Path, monkeypatch: Any, capsys: Any
) -> None:
    install(packages, ENTRIES)
    code, out, _ = run(monkeypatch, capsys, "count", "--last", 7, "--json")
    assert (code, json.loads(out)) == (0, {"last": 7})


@pytest.mark.parametrize(
    ("entries", "module", "what"),
    [
        ("acme = nowhere:write", PACKAGE, "nowhere:write .* ModuleNotFoundError"),
        ("acme = acme:nothing", PACKAGE, "AttributeError"),
        ("acme = acme:write", "1 / 0", "ZeroDivisionError"),
    ],
)
def test_a_damaged_package_is_named_where_it_is_used_and_only_there(
    entries: str, module: str, what: str, packages: Path, tmp_path: Path
) -> None:
    install(packages, f"[maidenflight.exporters]\n{entries}\n", module=module)
    made = policy.untrained_policy(jax.random.key(0))
    assert mf.export(made, tmp_path, "c")
    with pytest.raises(InputError, match="acme-drones") as refused:
        mf.export(made, tmp_path, "acme")
    assert re.search(what.replace(" .* ", ".*"), str(refused.value))


def test_entry_points_that_cannot_be_read_harm_no_name_of_ours(
    packages: Path, tmp_path: Path
) -> None:
    install(packages, "[maidenflight.exporters]\nacme\n")
    made = policy.untrained_policy(jax.random.key(0))
    assert mf.export(made, tmp_path, "c")
    with pytest.raises(InputError, match=r"entry points .* maidenflight\.exporters"):
        mf.export(made, tmp_path, "acme")


def test_a_damaged_log_format_is_named_where_no_other_reads_the_file(
    packages: Path, tmp_path: Path
) -> None:
    lines = "gone = nowhere:TABLE\nodd = acme:drone"
    install(packages, f"[maidenflight.log_formats]\n{lines}\n")
    flight_csv.write(tmp_path / "own.csv", calm())
    (tmp_path / "other.csv").write_text("clock,x\n1,2\n")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\xff")
    assert len(read_flights(tmp_path / "own.csv")) == 1
    assert len(read_flights(tmp_path)) == 1
    for name in ("other.csv", "binary.csv"):
        with pytest.raises(InputError, match="'gone': nowhere:TABLE of the package acme-drones"):
            read_flights(tmp_path / name)
        with pytest.raises(InputError, match="'odd': a function; expected"):
            read_flights(tmp_path / name)


def test_two_packages_with_one_name_are_told_and_none_replaces_ours(
    packages: Path, tmp_path: Path
) -> None:
    lines = "[maidenflight.exporters]\nc = acme:write\nacme = acme:write\n"
    install(packages, lines)
    install(packages, lines, "acme-again")
    made = policy.untrained_policy(jax.random.key(0))
    assert {path.suffix for path in mf.export(made, tmp_path, "c")} == {".h", ".c"}
    with pytest.raises(InputError, match="acme-again, acme-drones"):
        mf.export(made, tmp_path, "acme")


def test_no_package_is_looked_for_where_a_name_is_ours(
    tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    def looked(group: str) -> None:
        raise AssertionError(group)

    monkeypatch.setattr(registry, "_installed", looked)
    code, out, _ = run(monkeypatch, capsys, "export", "--help")
    assert code == 0
    assert "[c|onnx|authors|crazyflie|raptor|px4|...]" in out
    flight_csv.write(tmp_path / "own.csv", calm())
    assert len(read_flights(tmp_path)) == 1
    assert mf.reality("virtual:7")
    mf.export(policy.untrained_policy(jax.random.key(0)), tmp_path, "c")
