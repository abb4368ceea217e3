import json
from pathlib import Path

import pytest
import tomlkit
import toy_kinds

from commands import Command


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "study.toml"
    path.write_text(tomlkit.dumps({"task": toy_kinds.study(count=2)}))
    return path


def test_a_study_is_computed_shown_and_computed_again_where_told(
    study: Path, command: Command
) -> None:
    _, out, _ = command(f"sweep {study} --trust --status --json")
    assert json.loads(out)["state"] == "not begun"
    code, out, err = command(f"sweep {study} --trust --json --workers 2")
    said = json.loads(out)
    assert (code, err) == (0, "")
    assert (said["tasks"], said["found"], said["computed"]) == (6, 0, 6)
    assert len(said["rows"]) == 6
    written = Path("study/study.csv").read_bytes()
    code, out, _ = command(f"sweep {study} --trust")
    assert code == 0
    assert "study/study.csv" in out
    code, out, _ = command(f"sweep {study} --trust --overwrite --json")
    assert json.loads(out)["computed"] == 6
    assert Path("study/study.csv").read_bytes() == written
    _, out, _ = command(f"sweep {study} --trust --status")
    assert "ended" in out


def test_a_study_is_computed_at_an_address(study: Path, tmp_path: Path, command: Command) -> None:
    address = f"file://{tmp_path}/far"
    code, out, err = command(f"sweep {study} --trust -o {address} --workers 1 --json")
    assert (code, err) == (0, "")
    assert json.loads(out)["output"] == address
    assert (tmp_path / "far" / "study.csv").exists()


def test_the_report_shows_the_table_of_a_study_by_its_entries(
    study: Path, command: Command
) -> None:
    command(f"sweep {study} --trust --workers 1")
    code, _, err = command("report study -o report.html")
    assert (code, err) == (0, "")
    page = Path("report.html").read_text()
    for words in ("<h3>squared</h3>", "<h3>added</h3>", "squared.value", "0.3333", "even"):
        assert words in page


def test_failures_are_one_line_and_the_table_of_the_others_is_there(
    study: Path, command: Command
) -> None:
    entries = [{"name": "bad", "kind": "toy_kinds:Wrong"}, *toy_kinds.study(count=1)]
    study.write_text(tomlkit.dumps({"task": entries}))
    code, _, err = command(f"sweep {study} --trust --retries 0")
    assert code == 2
    assert len(err.splitlines()) == 1
    assert Path("study/study.csv").exists()


@pytest.mark.parametrize("words", ["--on cloud", "--slurm account", "--cpus 0", "-o study.toml"])
def test_wrong_options_are_refused(words: str, study: Path, command: Command) -> None:
    code, _, err = command(f"sweep {study} --trust {words}")
    assert (code, len(err.splitlines())) == (2, 1)
