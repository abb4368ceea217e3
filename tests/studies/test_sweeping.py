import dataclasses
from collections import Counter
from pathlib import Path
from typing import Any

import polars
import pytest
import toy_kinds

import maidenflight as mf
from maidenflight.errors import InputError
from maidenflight.studies import engine, local, status, study, worker
from maidenflight.studies.engine import Engine, Resources
from maidenflight.studies.status import Progress
from maidenflight.studies.store import Folder, opened
from maidenflight.studies.sweeping import LOSSES
from maidenflight.studies.worker import FAILED, LOST, Order, TaskResult


class Here:
    """An engine that does tasks in this process, and loses what it is told to lose."""

    def __init__(self, room: int = 3, losses: int = 0):
        self._most, self._losses = room, losses
        self.waiting: list[Order] = []
        self.submitted: list[str] = []
        self.closed = 0

    def room(self) -> int:
        return self._most - len(self.waiting)

    def submit(self, order: Order) -> None:
        self.submitted.append(order.key)
        self.waiting.append(order)

    def ended(self, timeout: float) -> list[TaskResult]:
        orders, self.waiting = self.waiting, []
        lost, self._losses = orders[: self._losses], max(0, self._losses - len(orders))
        done = [worker.perform(order) for order in orders[len(lost) :]]
        return [*(TaskResult(order.key, LOST, "node gone") for order in lost), *done]

    def close(self) -> None:
        self.closed += 1


def lines(path: Path) -> Counter[str]:
    return Counter(path.read_text().splitlines() if path.exists() else [])


def test_a_study_is_one_table_and_is_computed_once(tmp_path: Path) -> None:
    entries, here = toy_kinds.study(ran=str(tmp_path / "ran")), Here()
    heard: list[Progress] = []
    table = mf.sweep(entries, tmp_path / "out", here, on_progress=heard.append)
    assert table.height == 4 + 8
    assert table.columns[:4] == ["task", "kind", "squared.value", "added.more"]
    sums = table.filter(polars.col("task") == "added")
    expected = sums["squared.value"] ** 2 + sums["added.more"]
    assert sums["sum"].to_list() == expected.to_list()
    assert set(lines(tmp_path / "ran").values()) <= {1, 2}
    assert heard[-1].done == heard[-1].tasks == 12
    assert heard[-1].state == "ended"
    assert here.closed == 1
    written = (tmp_path / "out" / "study.csv").read_bytes()
    begun = lines(tmp_path / "ran")
    again = Here()
    assert mf.sweep(entries, tmp_path / "out", again).equals(table)
    assert lines(tmp_path / "ran") == begun
    assert again.submitted == []
    assert (tmp_path / "out" / "study.csv").read_bytes() == written
    wider = mf.sweep(toy_kinds.study(count=5, ran=str(tmp_path / "ran")), tmp_path / "out", again)
    assert wider.height == 5 + 10
    assert len(again.submitted) == 3


def test_processes_of_this_machine_give_the_same_bytes(tmp_path: Path) -> None:
    entries = toy_kinds.study(count=3)
    mf.sweep(entries, tmp_path / "here", Here())
    mf.sweep(entries, tmp_path / "local", "local", resources=Resources(2))
    for name in ("study.csv",):
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "local" / name).read_bytes()


def test_a_task_that_fails_is_tried_as_told_and_the_others_are_done(tmp_path: Path) -> None:
    ran = str(tmp_path / "ran")
    entries: list[dict[str, Any]] = [
        {"name": "bad", "kind": "toy_kinds:Wrong", "settings": {"ran": ran}},
        {"name": "worse", "kind": "toy_kinds:Wrong", "settings": {"how": "input"}},
        *toy_kinds.study(count=2),
    ]
    heard: list[Progress] = []
    with pytest.raises(InputError, match="2 of 8 tasks failed"):
        mf.sweep(entries, tmp_path / "out", Here(), retries=2, on_progress=heard.append)
    assert lines(tmp_path / "ran") == {"tried": 3}
    assert heard[-1].failed == ("bad", "worse")
    assert heard[-1].done == 6
    assert heard[-1].repeated == 4
    traces = sorted((tmp_path / "out" / "failures").iterdir())
    assert [path.name.partition("_")[0] for path in traces] == ["bad", "worse"]
    assert "Traceback" in traces[0].read_text()
    assert "Traceback" not in traces[1].read_text()
    assert polars.read_csv(tmp_path / "out" / "study.csv", comment_prefix="#").height == 6


def test_what_waits_for_a_task_that_failed_is_not_begun(tmp_path: Path) -> None:
    entries = toy_kinds.study(count=2)
    (tmp_path / "out" / "results").mkdir(parents=True)

    class Failing(Here):
        def ended(self, timeout: float) -> list[TaskResult]:
            endings = super().ended(timeout)
            return [dataclasses.replace(one, outcome=FAILED, message="no") for one in endings]

    failing = Failing()
    with pytest.raises(InputError, match="2 of 6 tasks failed, and 4 wait"):
        mf.sweep(entries, tmp_path / "out", failing, retries=0)
    assert len(failing.submitted) == 2


def test_a_task_that_is_lost_is_begun_again_but_not_for_ever(tmp_path: Path) -> None:
    entries = toy_kinds.study(count=2, more=1)
    table = mf.sweep(entries, tmp_path / "out", Here(losses=4), retries=0)
    assert table.height == 4
    with pytest.raises(InputError):
        mf.sweep(entries, tmp_path / "other", Here(room=1, losses=100))
    (trace, *_) = (tmp_path / "other" / "failures").iterdir()
    assert "node gone" in trace.read_text()
    assert LOSSES < 100


def test_a_process_that_is_killed_loses_its_own_task_alone(tmp_path: Path) -> None:
    entries: list[dict[str, Any]] = [
        {"name": "dying", "kind": "toy_kinds:Killed", "settings": {"ran": str(tmp_path / "ran")}},
        *toy_kinds.study(count=2, more=1, ran=str(tmp_path / "others")),
    ]
    heard: list[Progress] = []
    table = mf.sweep(
        entries,
        tmp_path / "out",
        "local",
        resources=Resources(2),
        retries=0,
        on_progress=heard.append,
    )
    assert table["survived"].to_list()[0] == 1
    assert lines(tmp_path / "ran") == {"killed": 2}
    assert heard[-1].repeated == 1
    assert set(lines(tmp_path / "others").values()) == {1}
    assert not (tmp_path / "out" / "failures").exists() or not list(
        (tmp_path / "out" / "failures").iterdir()
    )


def test_an_interrupted_study_goes_on(tmp_path: Path) -> None:
    entries = toy_kinds.study(count=3, ran=str(tmp_path / "ran"))

    def interrupt(now: Progress) -> None:
        if now.computed >= 3:
            raise KeyboardInterrupt

    here = Here(room=1)
    with pytest.raises(KeyboardInterrupt):
        mf.sweep(entries, tmp_path / "out", here, on_progress=interrupt)
    assert here.closed == 1
    asked = study.of(entries)
    now = status.read_status(opened(tmp_path / "out"), asked)
    assert (now.state, now.done, now.tasks) == ("interrupted", 3, 9)
    assert mf.sweep(entries, tmp_path / "out", Here()).height == 9
    assert lines(tmp_path / "ran")["begun 1"] == 1


def test_the_end_of_local_ends_its_processes(tmp_path: Path) -> None:
    (task,) = study.of(
        [{"name": "long", "kind": "toy_kinds:Square", "settings": {"value": 1, "seconds": 50}}]
    ).tasks
    order = Order(task.key, task.kind, "", dict(task.settings), {}, ".", str(tmp_path))
    working = local.Local(Resources(workers=1))
    working.submit(order)
    assert working.room() == 0
    while not list((tmp_path / "results").glob(".*.part")):
        assert not working.ended(0.05)
    working.close()
    assert Folder(tmp_path).keys() == set(), "it waited for a task of 50 s"


def test_each_process_gets_gpus_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0,2,5")
    assert local.Local(Resources(workers=8, gpus=1)).room() == 3
    assert local.Local(Resources(workers=8, gpus=2)).room() == 1
    with pytest.raises(InputError):
        local.Local(Resources(gpus=4))


def test_status_tells_a_study_that_nobody_began_or_goes_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, store = study.of(toy_kinds.study()), opened(tmp_path / "out")
    assert status.read_status(store, asked) == Progress(12, state="not begun")
    said = Progress(12, running=("squared",), seconds=3.0, on="local")
    status.write_status(store, said)
    assert status.read_status(store, asked) == said
    monkeypatch.setattr(status, "SILENT_S", -1.0)
    assert status.read_status(store, asked).state == "silent"
    store.write(status.PROGRESS, "{}")
    with pytest.raises(InputError):
        status.read_status(store, asked)


@pytest.mark.parametrize("name", ["cloud", "local:2", ""])
def test_an_unknown_engine_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        engine.engine(name, Resources(logs=str(tmp_path)))
    assert isinstance(Here(), Engine)


def test_two_drivers_do_not_write_the_same_study(tmp_path: Path) -> None:
    class Second(Here):
        def ended(self, timeout: float) -> list[TaskResult]:
            with pytest.raises(InputError, match="another maidenflight"):
                mf.sweep(toy_kinds.study(), tmp_path / "out", Here())
            return super().ended(timeout)

    assert mf.sweep(toy_kinds.study(count=1, more=1), tmp_path / "out", Second()).height == 2
