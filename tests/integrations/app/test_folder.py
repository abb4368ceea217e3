"""Files that the page takes and gives: none outside of the folder, whole or not at all."""

import errno
import io
import os
import zipfile
from pathlib import Path

import page_client
import pytest
from page_client import opened

from maidenflight import manifest
from maidenflight.errors import InputError
from maidenflight.integrations.app import folder as files


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "secret.txt").write_text("secret")
    run = tmp_path / "run"
    run.mkdir()
    (run / "own.csv").write_text("own")
    (run / ".hidden").write_text("secret")
    (run / "out.csv").symlink_to(tmp_path / "secret.txt")
    (run / "up").symlink_to(tmp_path, target_is_directory=True)
    return run


OUTSIDE = ("../secret.txt", "up/secret.txt", "out.csv", "/etc/passwd", "a/../../secret.txt")


@pytest.mark.parametrize("text", [*OUTSIDE, "near:3@../secret.toml", "a=/etc/passwd", "x\0y"])
def test_no_text_of_a_form_names_what_lies_outside(text: str, folder: Path) -> None:
    with pytest.raises(InputError):
        files.confine(folder, text)


@pytest.mark.parametrize("text", ["own.csv", "crazyflie_2.1+", "virtual:7@drone.toml", "1e-3", "."])
def test_other_texts_pass(text: str, folder: Path) -> None:
    assert files.confine(folder, text).is_relative_to(folder)


@pytest.mark.parametrize("kind", ["file", "zip"])
@pytest.mark.parametrize("name", [*OUTSIDE, ".hidden", "up", "nothing", "%2e%2e/secret.txt"])
def test_nothing_outside_or_hidden_is_sent(kind: str, name: str, folder: Path) -> None:
    record = {"version": "1", "settings": {}}
    manifest.append(folder / "own.csv", "train", {"policies": [folder / "own.csv"]}, record)
    with opened(folder) as client:
        for path in (name, name.replace("/", "%2f").replace("..", "%2e%2e")):
            answer = client.get(f"{kind}/{path}")
            assert answer.status_code in (403, 404, 422)
            assert "secret" not in answer.text.replace("secret.txt", "").replace("secret-token", "")


def test_a_manifest_of_a_stranger_sends_nothing_outside(folder: Path) -> None:
    record = {"version": "1", "settings": {}}
    manifest.append(folder / "up", "train", {"policies": [folder / "out.csv"]}, record)
    with opened(folder) as client:
        assert client.get("zip/up").status_code == 422
        assert client.get("file/out.csv").status_code == 422


def test_files_are_sent_to_be_saved_and_folders_as_one(folder: Path) -> None:
    (folder / "made").mkdir()
    (folder / "made" / "policy.c").write_text("int x;")
    record = {"version": "1", "settings": {}}
    manifest.append(folder / "made", "export", {"exported": [folder / "made/policy.c"]}, record)
    with opened(folder) as client:
        answer = client.get("file/own.csv")
        assert answer.text == "own"
        assert answer.headers["content-disposition"].startswith("attachment")
        assert answer.headers["content-type"] == "application/octet-stream"
        with zipfile.ZipFile(io.BytesIO(client.get("zip/made").content)) as packed:
            assert packed.namelist() == ["made/policy.c"]
            assert packed.read("made/policy.c") == b"int x;"


def put(client: page_client.TestClient, name: str, content: bytes) -> str:
    answer = client.put(f"logs/{name}", content=content)
    assert answer.status_code == 200, answer.text
    return answer.json()["name"]


def test_logs_are_kept_whole_and_nothing_is_overwritten(folder: Path) -> None:
    with opened(folder) as client:
        assert put(client, "log00", b"one") == "log00"
        assert put(client, "log00", b"one") == "log00"
        other = put(client, "log00", b"two")
        assert put(client, "log00", b"two") == other
        assert f'name="{other}"' in client.get("state").json()["logs"]
        assert client.delete("logs/log00").status_code == 200
        assert client.delete("logs/log00").status_code == 422
        assert client.delete("logs/..%2fown.csv").status_code == 422
    assert (folder / "logs" / other).read_bytes() == b"two"
    assert (folder / "own.csv").exists()


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("..%2f..%2fetc%2fpasswd", "passwd"),
        ("C:%5Cflights%5Clog.bbl", "log.bbl"),
        ("<script>alert(1)<%2fscript>.csv", "script_.csv"),
        ("<img src=x onerror=alert(1)>", "_img src_x onerror_alert(1)_"),
        (".bashrc", "bashrc"),
        ("--overwrite", "overwrite"),
        ("flug%09%C3%BCbung.csv", "flug_übung.csv"),
        ("a" * 300 + ".ulg", "a" * 60 + "a" * 8 + ".ulg"),
    ],
)
def test_names_of_logs_are_cleaned(name: str, kept: str, folder: Path) -> None:
    with opened(folder) as client:
        assert put(client, name, b"x") == kept
    assert [path.name for path in (folder / "logs").iterdir()] == [kept]


@pytest.mark.parametrize("name", ["...", "_", " ", "--"])
def test_names_of_nothing_are_refused(name: str) -> None:
    with pytest.raises(InputError):
        files.clean(name)


def test_too_much_is_refused_and_leaves_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "LARGEST", 1000)
    monkeypatch.setattr(files, "MOST", 2)

    def pieces() -> "object":
        for _ in range(20):
            yield b"x" * 100

    with opened(folder) as client:
        assert "larger" in client.put("logs/a", content=b"x" * 1001).json()["error"]
        assert "larger" in client.put("logs/a", content=pieces()).json()["error"]  # type: ignore[arg-type]
        assert not list((folder / "logs").iterdir())
        put(client, "a", b"x" * 1000)
        put(client, "b", b"x")
        assert "most" in client.put("logs/c", content=b"x").json()["error"]
    assert {path.name for path in (folder / "logs").iterdir()} == {"a", "b"}


def test_a_full_disk_is_one_clear_error_and_leaves_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("maidenflight.integrations.app.folder.os.link", full)
    with opened(folder) as client:
        answer = client.put("logs/a", content=b"x" * 1000)
        assert answer.status_code == 422
        assert "Free space" in answer.json()["error"]
    assert not list((folder / "logs").iterdir())


def test_a_link_in_place_of_the_logs_is_not_followed(folder: Path, tmp_path: Path) -> None:
    (folder / "logs").symlink_to(tmp_path, target_is_directory=True)
    with opened(folder) as client:
        assert client.put("logs/a", content=b"x").status_code == 422
    assert not (tmp_path / "a").exists()
