"""A result file is whole or not there, and its record says where it comes from without saying on
which machine."""

import os
import re

import pytest

from maidenflight import __version__, results
from maidenflight.errors import InputError


@pytest.mark.parametrize("content", ["grüße\r\nline two\n", b"\x00\xff\r\n", ""])
def test_a_file_holds_exactly_what_was_written(tmp_path, content):
    path = results.write(tmp_path / "new" / "folder" / "file.txt", content)
    assert path.read_bytes() == (content.encode() if isinstance(content, str) else content)
    assert os.listdir(path.parent) == ["file.txt"]


def test_writing_again_replaces_the_whole_file(tmp_path):
    path = results.write(tmp_path / "file.txt", "a long first content")
    results.write(path, "short")
    assert path.read_text() == "short"


@pytest.mark.parametrize("call", ["replace", "fdopen", "chmod"])
def test_a_failed_write_leaves_the_old_content_and_no_other_file(tmp_path, monkeypatch, call):
    path = results.write(tmp_path / "file.txt", "old")

    def full(*_arguments, **_options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(results.os, call, full)
    with pytest.raises(
        InputError, match=r"file\.txt: cannot be written \(No space left on device\).*-o"
    ):
        results.write(path, "new")
    monkeypatch.undo()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["file.txt"]


def test_a_place_that_cannot_be_written_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(InputError, match="cannot be written"):
        results.write(tmp_path / "file" / "below.txt", "text")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        results.write(tmp_path / "folder", "text")
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


def test_a_digest_is_the_start_of_the_sha256(tmp_path):
    assert results.digest(results.write(tmp_path / "abc", "abc")) == "ba7816bf8f01cfea"


def test_a_record_names_version_seed_inputs_and_settings_but_no_absolute_path(tmp_path):
    path = results.write(tmp_path / "flights" / "circle.csv", "abc")
    made = results.record(seed=3, inputs=[path], settings={"length": 30, "unused": None})
    assert made == {
        "version": __version__,
        "seed": 3,
        "inputs": ["circle.csv sha256:ba7816bf8f01cfea"],
        "settings": {"length": 30},
    }
    assert str(tmp_path) not in str(made)


def test_a_record_of_a_file_in_the_working_folder_does_not_look_like_an_absolute_path(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(results.write(tmp_path / "circle.csv", "abc").parent)
    assert not re.search(
        r"(^|['\"\s])/", str(results.record(seed=None, inputs=["circle.csv"], settings={}))
    )


def test_without_randomness_and_inputs_a_record_has_neither(tmp_path):
    assert results.record(seed=None, inputs=[], settings={}) == {
        "version": __version__,
        "settings": {},
    }


@pytest.mark.parametrize(
    ("text", "record"),
    [
        ('# flights 1\n# record: {"seed": 3}\na,b\n', {"seed": 3}),
        ("a,b\n# record: {}\n", {}),
        ("# record: {\n", {}),
        pytest.param(f"# record: {'[' * 100_000}\na\n", {}, id="deep"),
        ("# record: 3\na\n", {}),
        ('# record: {"a": 1, "a": 2}\na\n', {}),
        ("# record: [1]\na\n", {}),
        ("", {}),
    ],
)
def test_a_tables_record_is_found_in_its_comments(tmp_path, text, record):
    assert results.read_record(results.write(tmp_path / "table.csv", text)) == record
    assert results.read_record(tmp_path / "nothing.csv") == {}


def test_tables_of_an_earlier_run_of_the_same_kind_go_and_nothing_else(tmp_path):
    earlier, now = (
        {"seed": seed, "settings": {"flights": 2 - seed, "duration": 1.0}} for seed in (0, 1)
    )
    for name, record in {
        "flight_1": now,
        "flight_2": earlier,
        "other": {"settings": {"uri": "radio://"}},
        "odd": {"settings": 3},
    }.items():
        text = results.table_text("# a table", record, "time\n0.0\n")
        results.write(tmp_path / f"{name}.csv", text)
    (tmp_path / "mine.csv").write_text("time,x\n0,1\n")
    (tmp_path / "binary.csv").write_bytes(b"# \xff")
    results.remove_older([tmp_path / "flight_1.csv"], now)
    assert sorted(path.stem for path in tmp_path.iterdir()) == [
        "binary",
        "flight_1",
        "mine",
        "odd",
        "other",
    ]


def test_comments_are_read_and_what_follows_is_not(tmp_path):
    (tmp_path / "table.csv").write_bytes(
        b'# a\r\n# record: {"seed": 1}\ntime\n' + b"0.0\n" * 10_000 + b"\xff"
    )
    assert results.read_record(tmp_path / "table.csv") == {"seed": 1}
