import os
from pathlib import Path

import pytest

from maidenflight.errors import InputError
from maidenflight.studies import store
from maidenflight.studies.store import Folder, Store


@pytest.fixture(params=["folder", "memory", "file"])
def kept(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    if request.param == "folder":
        return store.opened(tmp_path / "study")
    pytest.importorskip("fsspec")
    monkeypatch.setattr("maidenflight.cache.folder", lambda: tmp_path / "cache")
    place = "memory://study" if request.param == "memory" else f"file://{tmp_path}/study"
    return store.opened(f"{place}/{os.urandom(4).hex()}")


def make(kept: Store, key: str, text: str = '{"rows": []}') -> None:
    with kept.making(key) as folder:
        (folder / "part").mkdir()
        (folder / "part" / "policy.json").write_text(text)
        (folder / store.RESULT).write_text(text)


def test_a_result_is_there_once_it_is_whole(kept: Store) -> None:
    assert not kept.has("a")
    assert kept.keys() == set()
    make(kept, "a")
    assert kept.has("a")
    assert kept.keys() == {"a"}
    assert kept.result("a") == {"rows": []}
    assert (kept.folder("a") / "part" / "policy.json").read_text() == '{"rows": []}'
    with pytest.raises(TypeError), kept.making("b") as folder:
        (folder / store.RESULT).write_text(None)  # type: ignore[arg-type]
    assert kept.keys() == {"a"}
    kept.tidy()
    kept.remove("a")
    kept.remove("a")
    assert kept.keys() == set()
    assert not kept.has("a")


def test_a_result_of_an_address_is_fetched_anew_into_a_private_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("fsspec")
    monkeypatch.setattr("maidenflight.cache.folder", lambda: tmp_path / "cache")
    remote = store.opened(f"memory://study/{os.urandom(4).hex()}")
    for text in ('{"rows": [1]}', '{"rows": [2]}'):
        make(remote, "a", text)
        fetched = remote.folder("a")
        assert (fetched / "part" / "policy.json").read_text() == text
        remote.remove("a")
    assert fetched.parents[1].stat().st_mode & 0o077 == 0


def test_who_comes_second_with_a_result_leaves_the_first(tmp_path: Path) -> None:
    kept = Folder(tmp_path)
    with kept.making("a") as folder:
        (folder / store.RESULT).write_text('{"rows": [2]}')
        make(kept, "a", '{"rows": [1]}')
    assert kept.result("a") == {"rows": [1]}
    assert os.listdir(tmp_path / "results") == ["a"]


def test_what_killed_tasks_left_goes_once_their_result_is_there(tmp_path: Path) -> None:
    kept = Folder(tmp_path)
    (tmp_path / "results" / ".a.abcdefgh.part").mkdir(parents=True)
    (tmp_path / "results" / ".b.abcdefgh.part").mkdir()
    assert kept.keys() == set()
    make(kept, "a")
    kept.tidy()
    assert set(os.listdir(tmp_path / "results")) == {"a", ".b.abcdefgh.part"}


def test_files_of_the_study_are_beside_its_results(kept: Store) -> None:
    assert kept.read("failures/one.txt") is None
    kept.write("failures/one.txt", "a\nb\n")
    assert kept.read("failures/one.txt") == "a\nb\n"
    kept.drop("failures/one.txt")
    kept.drop("failures/one.txt")
    assert kept.read("failures/one.txt") is None


def test_a_broken_result_and_an_unknown_address_are_told(tmp_path: Path) -> None:
    kept = Folder(tmp_path)
    make(kept, "a", "{")
    with pytest.raises(InputError, match="not a whole result"):
        kept.result("a")
    pytest.importorskip("fsspec")
    with pytest.raises(InputError, match="cannot be opened"):
        store.opened("nowhere://bucket/study")
