"""Steps run as commands of the folder, whoever looks: started, told of, cancelled and shown."""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import page_client
import pytest
from page_client import opened

from maidenflight import events, manifest, results
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv
from maidenflight.flights.log import Flight
from maidenflight.integrations.app import server
from maidenflight.integrations.app.app import App
from maidenflight.integrations.app.jobs import Job

Client = page_client.TestClient
RECORD = {"version": "1", "settings": {}}


def wait(client: Client, verb: str, *states: str) -> dict[str, Any]:
    end, step = time.monotonic() + 180, {"state": "unknown"}
    while step["state"] not in states:
        assert time.monotonic() < end, step
        time.sleep(0.05)
        step = client.get("state").json()["steps"][verb]
    return step


def run(client: Client, verb: str, **filled: Any) -> str:
    answer = client.post(f"run/{verb}", content=json.dumps(filled))
    return answer.json().get("error", "")


@pytest.mark.slow
def test_a_step_runs_in_the_folder_and_tells_its_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "numpy.py").write_text("raise SystemExit('imported from the folder')")
    with opened(tmp_path) as client:
        began = time.monotonic()
        assert run(client, "drone", drone="crazyflie", output="made.toml") == ""
        first = client.get("state").json()["steps"]["drone"]
        assert time.monotonic() - began < 1, "first words"
        assert "maidenflight drone --output=made.toml crazyflie" in first["html"]
        assert "starting" in first["html"]
        assert "running" in run(client, "drone")
        step = wait(client, "drone", "done", "failed")
        assert step["state"] == "done", step
        assert 'href="file/made.toml"' in step["html"]
        assert client.get("file/made.toml").text == (tmp_path / "made.toml").read_text()
        monkeypatch.setenv("COLUMNS", "40")
        assert run(client, "drone", drone="crazyflie", output="made.toml") == ""
        step = wait(client, "drone", "failed")
        assert re.search("already there.*--overwrite", step["html"]), "the whole error"


def test_a_step_is_cancelled_as_by_ctrl_c(tmp_path: Path) -> None:
    with opened(tmp_path) as client:
        run(client, "demo")
        client.post("cancel/demo")
        step = wait(client, "demo", "cancelled", "failed", "done")
        assert step["state"] == "cancelled"
        assert "Traceback" not in step["html"]
        assert re.search("interrupted|before it had begun", step["html"])
        client.post("cancel/demo")


def test_what_runs_is_interrupted_when_the_page_ends(tmp_path: Path) -> None:
    with opened(tmp_path) as client:
        run(client, "demo")
        time.sleep(0.3)
        began = time.monotonic()
    # A program that is being compiled is compiled to its end, a minute on a busy machine.
    assert time.monotonic() - began < 180


@pytest.mark.parametrize(
    ("verb", "filled"),
    [
        ("identify", {"logs": "/etc"}),
        ("identify", {"logs": "../.."}),
        ("train", {"task": "os:system"}),
        ("train", {"output": "/tmp/elsewhere"}),
        ("fly", {}),
        ("app", {"host": "0.0.0.0"}),
        ("nothing", {}),
    ],
)
def test_nothing_runs_that_reaches_outside_or_names_code(
    verb: str, filled: dict[str, Any], tmp_path: Path
) -> None:
    with opened(tmp_path) as client:
        assert run(client, verb, **filled)
        state = client.get("state").json()["steps"]
    assert all(step["state"] == "" for step in state.values())


def test_the_page_is_small() -> None:
    paths = Path(server.__file__).parent.rglob("*.*")
    lines = {path.name: path.read_text().count("\n") for path in paths if path.suffix != ".pyc"}
    assert sum(lines.values()) <= 1200, lines


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b"[" * 10_000, b"x" * 200_000, b"\xff"])
def test_what_is_no_form_runs_nothing(content: bytes, tmp_path: Path) -> None:
    with opened(tmp_path) as client:
        assert client.post("run/doctor", content=content).status_code == 422


def test_steps_and_files_come_from_the_manifest_and_are_escaped(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>"
    folder = tmp_path / evil.replace("/", "_")
    folder.mkdir()
    name = "<img src=x onerror=alert(2)>.toml"
    (folder / name).write_text("")
    manifest.append(folder / name, "identify", {"drone": [folder / name]}, RECORD)
    (folder / "logs").mkdir()
    (folder / "logs" / "<b>log").write_text("no log")
    with opened(folder) as client:
        page, state = client.get("").text, client.get("state").json()
    step = state["steps"]["identify"]
    assert step["state"] == "done"
    assert "<script>alert" not in page
    assert "<img src=x" not in page + step["html"]
    assert "%3Cimg%20src%3Dx" in step["html"]
    assert state["steps"]["validate"]["filled"]["drone"] == [name]
    assert "<b>" not in state["logs"]
    assert 'name="&lt;b&gt;log"' in state["logs"]


def test_a_damaged_manifest_is_told_and_the_page_stays(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text("{")
    with opened(tmp_path) as client:
        assert client.get("").status_code == 200
        assert "run.json" in client.get("state").json()["problem"]


def test_forms_begin_with_what_the_steps_before_wrote(tmp_path: Path) -> None:
    drone = results.write(tmp_path / "mine.toml", "")
    policy = results.write(tmp_path / "policies" / "policy_2.json", "{}")
    manifest.append(drone, "identify", {"drone": [drone]}, RECORD)
    manifest.append(policy.parent, "train", {"policies": [policy]}, RECORD)
    with opened(tmp_path) as client:
        steps = client.get("state").json()["steps"]
    assert steps["validate"]["filled"] == {"drone": ["mine.toml"], "logs": ["logs"]}
    assert steps["predict"]["filled"] == {"policies": ["policies"]}
    assert steps["export"]["filled"] == {"policy": ["policies/policy_2.json"]}


def circle() -> Flight:
    """Three seconds around a circle."""
    angle = np.arange(0, 3, 0.01)
    full, still = np.ones_like(angle), np.zeros((300, 3))
    position = np.stack([np.cos(angle), np.sin(angle), full], axis=1)
    command = np.full((300, 4), 0.55)
    state = position, still, still, still
    return Flight("flight", 0.01, *state, command, 4.0 * full, position, True, "virtual:1")


def test_logs_are_shown_with_the_reports_viewer(tmp_path: Path) -> None:
    path = flight_csv.write(tmp_path / "recorded" / "flight_1.csv", circle())
    manifest.append(path.parent, "record", {"logs": [path]}, RECORD)
    with opened(tmp_path) as client:
        view = client.get("view/log")
        assert view.status_code == 200, view.text
        assert 'id="logs"' in view.text
        assert not re.search(r"<script>|<script [^>]*javascript", view.text)
        for name in re.findall(r'src="../(asset/[\w.]+)"', view.text):
            script = client.get(name)
            assert script.headers["content-type"].startswith("text/javascript")
            assert "&amp;" not in script.text[:20_000]
        report = client.get("view/report")
        assert report.status_code == 200
        assert report.headers["content-security-policy"].startswith("sandbox allow-scripts")
        for name in ("identify", "nothing", "preview"):
            assert client.get(f"view/{name}").status_code == 404
        assert client.get("asset/nothing.js").status_code == 422


def test_a_command_tells_events_in_lines_of_json(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "maidenflight", "drone", "crazyflie"],
        env={**os.environ, events.VARIABLE: "1"},
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    )
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert told[0] == {"done": 0, "total": None, "remark": "loading"}
    assert "thrust_to_weight" in told[-1]["summary"][0]


def test_events_become_what_the_page_shows() -> None:
    job = Job("train", ["--updates=4", "--", "x"], None)  # type: ignore[arg-type]
    score = {"episode_return": -1.0, "survival": 0.5, "position_error": 0.1}
    for event in (
        {"done": 1, "total": 4, "remark": "flying"},
        {"note": "a note"},
        {"update": 2, "steps": 10, "scores": [score, score], "policy": "{}"},
        {"summary": ["a", {"title": "t", "columns": [], "rows": []}], "next": ["predict", "x"]},
    ):
        job.hear(json.dumps(event))
    job.hear("not json")
    job.hear("[1]")
    assert (job.done, job.total, job.remark, job.line) == (1, 4, "flying", "not json")
    assert list(job.notes) == ["a note"]
    assert [row["policy"] for row in job.scores] == [1, 2]
    assert job.scores[0]["steps"] == 10
    assert job.next == ["predict", "x"]
    assert job.command == "maidenflight train --updates=4 x"


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"folder": "nowhere"}, "no such folder"),
        ({"host": "0.0.0.0", "password_file": "long"}, "others know"),
        ({"host": "203.0.113.7"}, "--password-file"),
        ({"host": "203.0.113.7", "password_file": "short"}, "12 characters"),
        ({"host": "203.0.113.7", "password_file": "none"}, "can be read"),
        ({"host": "203.0.113.7", "password_file": "long"}, "cannot listen"),
    ],
)
def test_a_door_without_a_lock_is_refused(
    settings: dict[str, str], expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short").write_text("1234\n")
    (tmp_path / "long").write_text("a long password\n")
    with pytest.raises(InputError, match=expected):
        App.from_settings({"folder": tmp_path, "no_browser": True, **settings}).run()


def test_the_address_is_printed_and_served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    served: list[Any] = []
    monkeypatch.setattr(server, "serve", lambda *given: served.append(given))
    address = App(folder=tmp_path, no_browser=True).run().content["address"]
    ((folder, access, listening),) = served
    listening_port = listening.getsockname()[1]
    listening.close()
    assert folder == tmp_path
    assert address == f"http://127.0.0.1:{listening_port}/{access.token}/"
    assert len(access.token) >= 32
