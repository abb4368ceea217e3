"""run.json lists what each verb wrote, whole whatever happens, and moves with its folder."""

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import pytest
from hypothesis import given
from hypothesis import strategies as st

from maidenflight import manifest, policy, policy_file, results
from maidenflight.errors import InputError
from maidenflight.manifest import Entry, Manifest
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.verbs.export import Export

RECORD: dict[str, Any] = {"version": "0.1.0", "seed": 7, "settings": {"trials": 2}}


def make(path: Path, content: str = "x") -> Path:
    return results.write(path, content)


def append(folder: Path, output: str, verb: str = "identify", *names: str, **changes: Any) -> None:
    """Appends an entry of drones to a folder, and makes its files."""
    files = [make(folder / name) for name in names or (output,)]
    manifest.append(folder / output, verb, {"drone": files}, {**RECORD, **changes})


def outputs(folder: Path) -> list[tuple[str, str]]:
    return [(entry.verb, entry.output) for entry in manifest.read_manifest(folder).entries]


def test_an_entry_says_what_was_written_from_what_and_how(tmp_path: Path) -> None:
    logs = [make(tmp_path / "run" / "logs" / "b.csv", "1"), make(tmp_path / "a.csv", "2")]
    drone = make(tmp_path / "run" / "drone.toml")
    made = results.record(seed=7, inputs=logs, settings={"over": ["mass"], "trials": 2})
    path = manifest.append(drone, "identify", {"drone": [drone]}, made, {"logs": logs})
    assert path == tmp_path / "run" / "run.json"
    [entry] = manifest.read_manifest(tmp_path / "run").entries
    assert entry == Entry(
        "identify",
        "drone.toml",
        {"drone": ["drone.toml"]},
        {
            "logs": [
                f"logs/b.csv sha256:{results.digest(logs[0])}",
                f"a.csv sha256:{results.digest(logs[1])}",
            ]
        },
        made["version"],
        7,
        {"over": ["mass"], "trials": 2},
    )
    assert str(tmp_path) not in path.read_text()


def test_the_parent_of_the_output_is_the_run_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for output, home in (("a", "run.json"), ("b/c/", "b/run.json"), (".", "run.json")):
        file = make(Path(output, "flight_01.csv"))
        assert manifest.append(output, "record", {"logs": [file]}, RECORD) == Path(home)
    assert outputs(Path()) == [("record", "a"), ("record", ".")]
    assert manifest.read_manifest("b").entries[0].written == {"logs": ["c/flight_01.csv"]}
    assert not (tmp_path / "run.json").exists()


def test_the_same_verb_and_output_replaces_its_entry_and_the_bytes_are_the_same(
    tmp_path: Path,
) -> None:
    for _ in range(3):
        append(tmp_path, "a.toml")
        append(tmp_path, "b.toml", "identify", "b.toml", seed=3)
    before = (tmp_path / "run.json").read_bytes()
    assert outputs(tmp_path) == [("identify", "a.toml"), ("identify", "b.toml")]
    append(tmp_path, "a.toml")
    assert outputs(tmp_path) == [("identify", "b.toml"), ("identify", "a.toml")]
    append(tmp_path, "b.toml", "identify", "b.toml", seed=3)
    assert (tmp_path / "run.json").read_bytes() == before


def test_a_file_is_listed_by_its_latest_writer_alone(tmp_path: Path) -> None:
    append(tmp_path, "logs", "record", "logs/1", "logs/2")
    append(tmp_path, "logs", "fly", "logs/2", "logs/3")
    entries = manifest.read_manifest(tmp_path).entries
    assert [entry.written for entry in entries] == [
        {"drone": ["logs/1"]},
        {"drone": ["logs/2", "logs/3"]},
    ]
    append(tmp_path, "other", "log", "logs/1")
    assert outputs(tmp_path) == [("fly", "logs"), ("log", "other")]


def test_files_outside_and_files_that_are_not_there_are_left_out(tmp_path: Path) -> None:
    inside, outside = make(tmp_path / "run" / "a"), make(tmp_path / "b")
    files = [inside, outside, tmp_path / "run" / "none"]
    manifest.append(tmp_path / "run" / "logs", "record", {"logs": files, "truth": []}, RECORD)
    assert manifest.read_manifest(tmp_path / "run").entries[0].written == {"logs": ["a"]}


APPENDS = """
import sys
from pathlib import Path
from maidenflight import manifest
for number in range(10):
    drone = Path(sys.argv[1], f"{sys.argv[2]}_{number}.toml")
    drone.write_text("x")
    manifest.append(drone, "identify", {"drone": [drone]}, {"version": "0.1.0"})
"""


def test_processes_that_append_at_once_lose_nothing(tmp_path: Path) -> None:
    processes = [
        subprocess.Popen([sys.executable, "-c", APPENDS, tmp_path, str(process)])
        for process in range(4)
    ]
    assert [process.wait() for process in processes] == [0] * 4
    assert sorted(outputs(tmp_path)) == sorted(
        ("identify", f"{process}_{number}.toml") for process in range(4) for number in range(10)
    )
    assert results.leftovers(tmp_path) == []


def test_it_waits_for_another_process_and_then_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(manifest, "_LOCK_TIMEOUT", 0.3)
    release = results.claim(tmp_path / "run.json")
    with pytest.raises(InputError, match="another maidenflight is writing there"):
        append(tmp_path, "a.toml")
    release()
    append(tmp_path, "a.toml")


ENTRY = {
    **{"verb": "record", "output": "logs", "written": {"logs": ["logs/1"]}, "inputs": {}},
    **{"version": "0.1.0", "seed": 7, "settings": {}},
}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not valid JSON"),
        ("\ud800", "cannot be read as text"),
        ("[]", "expected a table"),
        ({"entries": []}, "format is missing"),
        ({"format": "maidenflight run 9", "entries": []}, "format is maidenflight run 9, expected"),
        ({"entries": {}}, "entries"),
        ({"entries": [3]}, "manifest.entries is '3'"),
        *(
            ({"entries": [{**ENTRY, name: value}]}, name)
            for name, value in (
                *[("verb", 3), ("output", None), ("written", []), ("inputs", "a"), ("seed", "7")],
                *[("version", 1), ("settings", [])],
            )
        ),
        ({"entries": [{**ENTRY, "written": {"logs": "a"}}]}, "logs is a, expected a list of files"),
        ({"entries": [{**ENTRY, "written": {"logs": [3]}}]}, "expected a list of files"),
        ({"entries": [{**ENTRY, "written": {"logs": ["../a"]}}]}, "files in the run folder"),
        ({"entries": [{**ENTRY, "written": {"logs": ["/etc/passwd"]}}]}, "files in the run folder"),
        ({"entries": [{**ENTRY, "inputs": {"logs": ["/etc/passwd sha256:0"]}}]}, "in the run"),
    ],
)
def test_a_damaged_manifest_is_one_clear_error(tmp_path: Path, content: Any, message: str) -> None:
    path = tmp_path / "run.json"
    if isinstance(content, str):
        path.write_bytes(content.encode("utf-8", "surrogatepass"))
    else:
        bare = "format" in content or content == {"entries": []}
        path.write_text(json.dumps(content if bare else {"format": manifest.FORMAT, **content}))
    before = path.read_bytes()
    with pytest.raises(InputError, match=message) as caught:
        manifest.read_manifest(tmp_path)
    assert str(path) in str(caught.value)
    with pytest.raises(InputError, match=f"{message}.*The results of identify in .* are whole"):
        append(tmp_path, "a.toml")
    assert path.read_bytes() == before
    assert (tmp_path / "a.toml").exists()


def test_what_a_verb_wrote_is_whole_where_the_manifest_is_damaged(tmp_path: Path) -> None:
    file = tmp_path / "policy_1.json"
    policy_file.write_policy(
        file, policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(4,)))
    )
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(InputError, match=r"The results of export in .*code are whole"):
        Export(policy=file).run(tmp_path / "code")
    assert {path.name for path in (tmp_path / "code").iterdir()} == {"policy.h", "policy.c"}


def test_files_that_are_gone_are_missing_and_the_others_are_found(tmp_path: Path) -> None:
    append(tmp_path / "run", "logs", "record", "logs/1", "logs/2")
    (tmp_path / "run").rename(tmp_path / "moved")
    (tmp_path / "moved" / "logs" / "1").unlink()
    found = manifest.read_manifest(tmp_path / "moved")
    assert found.files(found.entries[0], "drone") == [tmp_path / "moved" / "logs" / "2"]
    assert found.missing == ["logs/1"]
    assert manifest.read_manifest(tmp_path) == Manifest(tmp_path)


def test_a_file_read_is_found_where_it_is_the_same(tmp_path: Path) -> None:
    log, drone = make(tmp_path / "logs" / "1.csv", "1"), make(tmp_path / "drone.toml")
    made = results.record(seed=None, inputs=[log], settings={})
    manifest.append(drone, "identify", {"drone": [drone]}, made, {"logs": [log]})
    found = manifest.read_manifest(tmp_path)
    assert found.read_files(found.entries[0], "logs") == [log]
    log.write_text("2")
    assert found.read_files(found.entries[0], "logs") == []


def test_a_path_belongs_to_the_nearest_manifest_that_lists_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    append(tmp_path, "drone.toml")
    logs = [make(tmp_path / "logs" / name) for name in ("1.csv", "2.csv")]
    manifest.append(tmp_path / "logs", "record", {"logs": logs}, RECORD)
    make(tmp_path / "notes.txt")

    def verbs(place: Path) -> Mapping[str, Any] | None:
        found = manifest.find_manifest(place)
        return found and {entry.verb: entry.written for entry in found.entries}

    monkeypatch.chdir(tmp_path)
    for home in (tmp_path, Path()):
        assert verbs(home) is not None
        assert set(verbs(home) or ()) == {"identify", "record"}
        assert set(verbs(home / "drone.toml") or ()) == {"identify"}
        assert verbs(home / "logs") == {"record": {"logs": ["logs/1.csv", "logs/2.csv"]}}
        assert verbs(home / "logs" / "2.csv") == {"record": {"logs": ["logs/2.csv"]}}
        for other in ("notes.txt", "nowhere"):
            assert verbs(home / other) is None
    append(tmp_path / "logs", "inner.toml")
    assert set(verbs(tmp_path / "logs") or ()) == {"identify"}
    assert verbs(tmp_path / "logs" / "1.csv") is None


plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)
name = st.text(
    st.characters(blacklist_characters="/\0", blacklist_categories=["Cs"]), min_size=1, max_size=20
).filter(lambda text: text not in (".", ".."))


@given(
    verb=st.text(),
    names=st.lists(name, min_size=1, max_size=3, unique=True),
    settings=st.dictionaries(st.text(), plain, max_size=3),
    seed=st.none() | st.integers(0, 2**40),
)
def test_an_entry_reads_back_as_it_was_appended(
    tmp_path_factory: pytest.TempPathFactory,
    verb: str,
    names: list[str],
    settings: dict[str, Any],
    seed: int | None,
) -> None:
    folder = tmp_path_factory.mktemp("run")
    record = {"version": "1", "settings": settings, **({} if seed is None else {"seed": seed})}
    files = []
    for each in names:
        path = folder / "out" / each
        if len(each.encode()) <= 200:
            files.append(make(path))
    manifest.append(folder / "out", verb, {"logs": files}, record)
    [entry] = manifest.read_manifest(folder).entries
    assert entry == Entry(
        verb,
        "out",
        {"logs": [f"out/{path.name}" for path in files]} if files else {},
        {},
        "1",
        seed,
        settings,
    )


def test_it_imports_no_stage_of_the_pipeline() -> None:
    code = "import sys, maidenflight.manifest; print({'jax', 'polars', 'numpy'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
