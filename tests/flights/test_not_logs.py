"""Files that are not read are named, alone and in folders, with what to do."""

from pathlib import Path

import pytest

from made_flights import calm
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv, not_logs
from maidenflight.flights.reading import read_flights


def put(path: Path, begins: bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(begins + bytes(range(256)))
    return path


def said(path: Path) -> str:
    with pytest.raises(InputError) as refused:
        read_flights(path)
    return str(refused.value)


@pytest.mark.parametrize("kind", not_logs.KINDS, ids=lambda kind: kind.single)
def test_a_file_of_another_kind_is_named_alone_and_in_a_folder(
    kind: not_logs.Foreign, tmp_path: Path
) -> None:
    path = put(tmp_path / f"flight{kind.suffix or '.csv'}", kind.begins)
    assert f"this is {kind.single}, which is not read. {kind.remedy}." in said(path)
    other = put(tmp_path / "logs" / "one" / f"flight{kind.suffix or '.bin'}", kind.begins)
    assert f"logs: no flight logs that are read, but {kind.single}" in said(tmp_path / "logs")
    other.with_stem("second").write_bytes(other.read_bytes())
    assert f"but 2 {kind.several}, which are not read. {kind.remedy}." in said(tmp_path / "logs")


def test_kinds_together_have_each_remedy_once(tmp_path: Path) -> None:
    for name, begins in (
        ("a.bin", b"#ROSBAG"),
        ("b.h5", b"\x89HDF"),
        ("c.xlsx", b"PK\3\4"),
    ):
        put(tmp_path / name, begins)
    put(tmp_path / "training.npz", b"PK\3\4")
    words = said(tmp_path)
    assert "a ROS 1 bag and an HDF5 file and an Excel workbook, which are" in words
    assert words.count("docs/flight-log.md") == 1
    assert words.count("Save its sheet as CSV") == 1


def test_beside_logs_they_are_a_note(tmp_path: Path) -> None:
    flight_csv.write(tmp_path / "good.csv", calm(rows=200))
    put(tmp_path / "a.bin", b"#ROSBAG")
    (note,) = [note for note in read_flights(tmp_path).notes if "ROS 1" in note]
    assert note.startswith(f"{tmp_path.name}: also holds a ROS 1 bag, which is not read.")


def test_a_folder_of_other_things_tells_where_to_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert said(Path()).endswith("maidenflight record -o flights).")
    (tmp_path / "notes.md").write_text("of today")
    assert said(Path()).endswith("maidenflight record -o flights).")
    (tmp_path / "empty").mkdir()
    assert said(Path("empty")).endswith("maidenflight record -o empty).")
