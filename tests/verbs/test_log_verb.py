"""`Log` shows logs of any format, and converts them."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from commands import Command
from made_flights import driven, sensed
from maidenflight import manifest, results
from maidenflight.flights import flight_csv
from maidenflight.flights.reading import read_flights
from run_listing import unlisted


def test_logs_of_any_format_are_told_and_converted(tmp_path: Path, command: Command) -> None:
    flight_csv.write(tmp_path / "logs" / "one.csv", driven())
    (tmp_path / "logs" / "bad.csv").write_text("x,y\n1,2\n")
    converted = tmp_path / "converted"
    code, out, _ = command(f"log {tmp_path}/logs -o {converted} --json")
    told = json.loads(out)
    assert code == 0
    (one,) = told["logs"]
    assert (one["pieces"], one["rate"], one["seconds"]) == (1, 100.0, 9.0)
    assert told["dropped"] or told["refused"]
    (written,) = told["written"]
    (back,), (before,) = read_flights(written), read_flights(tmp_path / "logs")
    for group, values in before.arrays.items():
        np.testing.assert_allclose(back.arrays[group], values, atol=1e-6)
    record = results.read_record(Path(written))
    assert record is not None
    assert "one.csv" in str(results.recorded_inputs(record, "one.csv"))
    assert unlisted(tmp_path) == {"logs/one.csv", "logs/bad.csv"}
    (entry,) = manifest.read_manifest(tmp_path).entries
    assert entry.inputs["logs"][0].startswith("logs/one.csv sha256:")
    code, _, err = command(f"log {tmp_path}/logs -o {converted}")
    assert code == 2
    assert "--overwrite" in err
    code, out, _ = command(f"log {tmp_path}/logs")
    assert code == 0
    assert "one.csv" in out


def test_the_check_up_is_shown_and_a_fault_ends_with_an_error(
    tmp_path: Path, command: Command
) -> None:
    flight = driven(900)
    flight_csv.write(tmp_path / "good.csv", flight)
    code, out, _ = command(f"log {tmp_path}")
    assert code == 0
    assert "Check-up against physics" in out
    assert re.search(r"physics: \d+ of \d+ tests pass in every log", out)
    assert "motor order" not in out, "what passes needs no row"
    turned = replace(flight, command=flight.command[:, [3, 2, 1, 0]])
    flight_csv.write(tmp_path / "bad.csv", turned)
    code, out, err = command(f"log {tmp_path}")
    assert code == 2
    assert "✗" in out
    assert "look permuted" in out
    assert re.search(r"motor order +✗ fails 1, ✓ passes 1 +\d", out)
    assert "1 of 2 logs contradict physics" in err
    code, out, _ = command(f"log {tmp_path} --json")
    verdicts = {
        one["name"]: one["verdict"] for one in json.loads(out)["checks"][f"{tmp_path.name}/bad.csv"]
    }
    assert verdicts["motor order"] == "fails"


def test_tables_of_other_columns_are_read_by_a_map_that_is_written(
    tmp_path: Path, command: Command
) -> None:
    flight = driven()
    rows = np.column_stack([0.01 * np.arange(len(flight)), flight.body_rates, flight.command])
    force = np.tile([0.0, 0.0, 9.81], (len(rows), 1)) + np.random.default_rng(0).normal(
        0, 0.2, (len(rows), 3)
    )
    names = "t,wx,wy,wz,m1,m2,m3,m4,ax,ay,az"
    path = tmp_path / "mine.csv"
    np.savetxt(path, np.column_stack([rows, force]), delimiter=",", header=names)
    code, _, err = command(f"log {path}")
    assert code == 2
    assert "--map-columns" in err
    code, out, _ = command(f"log {path} --map-columns --json")
    assert code == 0
    told = json.loads(out)
    assert told["written"] == [str(tmp_path / "mine.columns.toml")]
    assert told["logs"][0]["rate"] == 100.0


def test_a_signal_that_is_not_used_is_named_with_the_reason(
    tmp_path: Path, command: Command
) -> None:
    dead = np.zeros((600, 3), np.float32)
    flight_csv.write(tmp_path / "dead.csv", replace(sensed(), accelerometer=dead, rotor_speed=None))
    _, out, _ = command(f"log {tmp_path}/dead.csv")
    lines = {one.partition(" (")[0]: one for one in out.splitlines() if one.startswith("not used")}
    assert out.count("never change") == 1
    assert "1 file, 1 usable piece of flight" in out
    assert set(lines) == {"not used: accelerometer", "not used: rotor speed"}
    assert "never change" in lines["not used: accelerometer"]
    assert "not logged" in lines["not used: rotor speed"]
