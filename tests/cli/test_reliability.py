"""Outputs: nothing is written over that was not made for it, a place that cannot be written keeps
what it held, and two runs do not mix."""

import errno
import gc
import hashlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import pytest
from filelock import FileLock

import maidenflight
from commands import Command
from maidenflight import cache, manifest, parameters, policy, policy_file, results
from maidenflight.errors import InputError
from maidenflight.registry import VERBS
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.verb import find_verb

SOURCE = Path(maidenflight.__file__).parent
FREE = {
    "results.py": "the one that writes",
    "integrations/app/folder.py": "a log that is dropped, named when all of it is there",
    "integrations/radio/row_files.py": "packets of a real flight are appended as they come",
    "integrations/monitoring/loggers.py": "event files, written by their own packages",
    "training/checkpoint.py": "an archive in memory",
    "integrations/raptor/px4.py": "likewise",
    "cache.py": "the cache of compiled programs",
    "studies/store.py": "a folder of a result, renamed when all of it is written",
    "integrations/simulators/crazyflow.py": "what its process prints, in a temporary folder",
}
"""Modules that may open files for writing or remove them, and why."""
# Not of Click's formatter, which writes help.
WRITES = re.compile(
    r"(?<!formatter)\.write_text\(|\.write_bytes\(|\bopen\([^)\n]*[\"'][rb]*[wax+]|os\.open\(|savefig\(|np\.savez?\(|\.write_parquet\(|\.write_csv\([^)\n]*[\"'/]|"
    r"shutil\.|os\.(replace|rename|remove|truncate)\(|\.rename\(|\.touch\("
)


def test_files_are_written_in_one_place() -> None:
    writing = {
        str(path.relative_to(SOURCE))
        for path in SOURCE.rglob("*.py")
        if WRITES.search(re.sub(r'""".*?"""', "", path.read_text(), flags=re.DOTALL))
    }
    assert writing <= FREE.keys(), "write it with results.write"


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a policy and what a report can be made of."""
    folder = tmp_path_factory.mktemp("small")
    policy_file.write_policy(
        folder / "policies" / "policy_1.json",
        policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(3,))),
        {"seed": 1},
    )
    parameters.write_drone(folder / "drone.toml", parameters.crazyflie())
    policies = [folder / "policies" / "policy_1.json"]
    manifest.append(folder / "policies", "train", {"policies": policies}, {"seed": 1})
    manifest.append(folder / "drone.toml", "identify", {"drone": [folder / "drone.toml"]}, {})
    return folder


COMMANDS = {
    "drone": ["drone", "crazyflie", "-o", "{place}"],
    "log": ["log", "{small}", "-o", "{place}"],
    "plan": ["plan", "crazyflie", "-o", "{place}"],
    "record": ["record", "-o", "{place}"],
    "identify": ["identify", "{small}", "-o", "{place}"],
    "match": ["match", "{small}", "{small}/policies", "-o", "{place}"],
    "validate": ["validate", "crazyflie", "{small}", "-o", "{place}"],
    "train": ["train", "--drone", "crazyflie", "-o", "{place}"],
    "transfer": ["transfer", "{small}/policies", "-o", "{place}"],
    "predict": ["predict", "{small}/policies", "--drone", "crazyflie", "-o", "{place}"],
    "envelope": ["envelope", "{small}/policies", "-o", "{place}"],
    "export": ["export", "{small}/policies/policy_1.json", "-o", "{place}"],
    "report": ["report", "{small}", "-o", "{place}"],
    "demo": ["demo", "-o", "{place}"],
    "doctor": ["doctor", "-o", "{place}"],
}
"""All that write into a place of their own: fly only adds to one, app writes nothing by itself, and
sweep writes what it shares with other machines."""


def asked(verb: str, small: Path, place: Path) -> list[str]:
    return [argument.format(small=small, place=place) for argument in COMMANDS[verb]]


def files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_every_command_that_writes_is_here() -> None:
    assert COMMANDS.keys() == VERBS.own.keys() - {"app", "fly", "sweep"}


@pytest.mark.parametrize("verb", COMMANDS)
@pytest.mark.parametrize("what", ["file", "folder", "link"])
def test_nothing_is_written_over_what_is_there(
    verb: str, what: str, small: Path, tmp_path: Path, command: Command
) -> None:
    place = tmp_path / "mine"
    if what == "file":
        place.write_text("my thesis")
    elif what == "folder":
        place.mkdir()
        (place / "thesis.txt").write_text("my thesis")
    else:
        (tmp_path / "thesis.txt").write_text("my thesis")
        place.symlink_to(tmp_path / "thesis.txt")
    before = files(tmp_path)
    code, out, err = command(asked(verb, small, place))
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert "already there" in err
    assert files(tmp_path) == before


@pytest.mark.parametrize(
    ("verb", "beside"),
    [
        ("identify", "made_identification.csv"),
        ("identify", "made_identification.svg"),
        ("validate", "made_windows.csv"),
    ],
    ids=["identify", "its picture", "validate"],
)
def test_nor_over_the_second_file(
    verb: str, beside: str, small: Path, tmp_path: Path, command: Command
) -> None:
    (tmp_path / beside).write_text("my thesis")
    code, _, err = command(asked(verb, small, tmp_path / "made.csv"))
    assert code == 2
    assert f"{beside}: already there" in err
    assert files(tmp_path) == {beside: b"my thesis"}


def test_a_report_replaces_a_report(small: Path, tmp_path: Path, command: Command) -> None:
    for _ in range(2):
        assert command(asked("report", small, tmp_path / "page.html"))[0] == 0
    (tmp_path / "page.html").write_text("my thesis")
    assert command(asked("report", small, tmp_path / "page.html"))[0] == 2
    assert command(asked("report", small, tmp_path / "page.html"), "--overwrite")[0] == 0


QUICK = ("drone", "export", "report")
"""Commands that write without compiling; the others write in the same way."""


@pytest.mark.parametrize(
    ("call", "number"),
    [
        *(("mkstemp", errno.EROFS), ("mkstemp", errno.EACCES), ("fsync", errno.ENOSPC)),
        *(("fsync", errno.EIO), ("replace", errno.EDQUOT)),
    ],
)
@pytest.mark.parametrize("verb", QUICK)
def test_a_place_that_cannot_be_written_gives_one_line_and_keeps_what_it_held(
    verb: str,
    call: str,
    number: int,
    small: Path,
    tmp_path: Path,
    monkeypatch: Any,
    command: Command,
) -> None:
    place = tmp_path / "made"
    code, *_ = command(asked(verb, small, place))
    assert code == 0
    before = files(tmp_path)

    def fails(*_arguments: Any, **_options: Any) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(tempfile if call == "mkstemp" else os, call, fails)
    code, out, err = command(asked(verb, small, place), "--overwrite")
    monkeypatch.undo()
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert f"cannot be written ({os.strerror(number)})" in err
    assert files(tmp_path) == before


@pytest.mark.parametrize("verb", QUICK)
@pytest.mark.parametrize("place", ["file/below", "/proc/1/below", "/dev/null/below"])
def test_a_place_that_is_no_folder_is_told(
    verb: str, place: str, small: Path, tmp_path: Path, command: Command
) -> None:
    (tmp_path / "file").write_text("mine")
    code, out, err = command(asked(verb, small, tmp_path / place))
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert "cannot be written" in err
    assert files(tmp_path) == {"file": b"mine"}


_HOLDS = """
import sys, time
from maidenflight import results
back = results.claim(sys.argv[1])
print("held", flush=True)
time.sleep(60)
"""


def test_two_runs_in_one_place_do_not_mix(small: Path, tmp_path: Path, command: Command) -> None:
    place = tmp_path / "made"
    other = subprocess.Popen(
        [sys.executable, "-c", _HOLDS, str(place)], stdout=subprocess.PIPE, text=True
    )
    assert other.stdout is not None
    assert other.stdout.readline() == "held\n"
    try:
        for verb in COMMANDS:
            code, out, err = command(asked(verb, small, place))
            assert (code, out) == (2, ""), verb
            assert "another maidenflight is writing there" in err
        assert files(tmp_path) == {}
    finally:
        other.send_signal(signal.SIGKILL)
        other.communicate()
    assert command(asked("drone", small, place))[0] == 0


def test_a_place_is_given_back(tmp_path: Path) -> None:
    back = results.claim(tmp_path / "made")
    with pytest.raises(InputError, match="another maidenflight is writing there"):
        results.claim(tmp_path / "x" / ".." / "made")
    results.claim(tmp_path / "elsewhere")()
    back()
    results.claim(tmp_path / "made")()
    assert list(tmp_path.iterdir()) == []


def test_a_place_given_back_leaves_nothing(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("maidenflight.cache.folder", lambda: tmp_path / "cache")
    back = results.claim(tmp_path / "made")
    assert [path.suffix for path in (tmp_path / "cache" / "locks").iterdir()] == [".lock"]
    back()
    assert list((tmp_path / "cache" / "locks").iterdir()) == []


def test_what_others_put_into_the_temporary_folder_blocks_no_run(
    tmp_path: Path, monkeypatch: Any
) -> None:
    """A lock of another user's under the name that ours would have, or had in earlier versions."""
    shared = tmp_path / "tmp"
    shared.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(shared))
    monkeypatch.setattr("maidenflight.cache.folder", lambda: tmp_path / "cache")
    place = tmp_path / "made"
    name = hashlib.sha256(os.fsencode(place.resolve())).hexdigest()[:16]
    held = [FileLock(shared / f"maidenflight-{os.getuid()}-{name}.lock")]
    (shared / f"maidenflight-{os.getuid()}").mkdir()
    held.append(FileLock(shared / f"maidenflight-{os.getuid()}" / f"{name}.lock"))
    for lock in held:
        lock.acquire()
    back = results.claim(place)
    with pytest.raises(InputError, match="another maidenflight"):
        results.claim(place)
    back()
    for lock in held:
        lock.release()


@pytest.mark.parametrize("evil", ["link", "open to all", "a file"])
def test_a_folder_that_others_may_write_to_holds_no_locks(
    evil: str, tmp_path: Path, monkeypatch: Any
) -> None:
    """The home cannot be written to, and in the temporary folder somebody was quicker."""
    home = tmp_path / "home"
    home.write_text("")
    monkeypatch.setattr("maidenflight.cache.folder", lambda: home / "cache")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    place = tmp_path / f"maidenflight-{os.getuid()}"
    assert cache.find_private_folder("locks") == place / "locks"
    (place / "locks").rmdir()
    place.rmdir()
    if evil == "link":
        (tmp_path / "theirs").mkdir()
        place.symlink_to(tmp_path / "theirs")
    elif evil == "a file":
        place.write_text("")
    else:
        place.mkdir()
        place.chmod(0o777)
    assert cache.find_private_folder("locks") is None
    results.claim(tmp_path / "made")()


def test_a_place_that_is_given_back_while_another_asks_for_it_is_claimed_anew(
    tmp_path: Path, monkeypatch: Any
) -> None:
    import fcntl

    given, backs = fcntl.flock, [results.claim(tmp_path / "made")]

    def just_before(descriptor: int, how: int) -> None:
        if backs:
            backs.pop()()
        given(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", just_before)
    back = results.claim(tmp_path / "made")
    with pytest.raises(InputError, match="another maidenflight"):
        results.claim(tmp_path / "made")
    back()


@pytest.mark.parametrize("option", ["--duration", "--excitation"])
def test_a_number_that_is_none_is_refused(option: str, tmp_path: Path, command: Command) -> None:
    code, _, err = command(f"record -o {tmp_path}/made {option} nan")
    assert code == 2
    assert "'nan'; expected a number from" in err


@pytest.mark.parametrize(
    "verb",
    [name for name in COMMANDS if find_verb(name).resumable_from is None],
)
def test_ctrl_c_is_one_line_and_130(
    verb: str, small: Path, tmp_path: Path, monkeypatch: Any, command: Command
) -> None:
    def interrupted(*_arguments: Any, **_options: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(find_verb(verb), "compute", interrupted)
    code, out, err = command(asked(verb, small, tmp_path / "made"))
    assert (code, out) == (130, "")
    assert (
        err.strip()
        == "maidenflight: interrupted; finished files are complete, the rest was not written."
    )
    assert files(tmp_path) == {}


@pytest.fixture
def hears_ctrl_c() -> Iterator[None]:
    """Python's own handler: a shell starts what runs in its background with SIGINT ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("hears_ctrl_c")
def test_ctrl_c_in_a_callback_of_the_garbage_collector_is_not_lost(
    monkeypatch: Any, command: Command
) -> None:
    def collecting(phase: str, _told: Any) -> None:
        if phase == "start" and not fired:
            fired.append(1)
            raise KeyboardInterrupt

    def busy(*_given: Any) -> None:
        gc.callbacks.append(collecting)
        gc.collect()
        for _ in range(100):
            time.sleep(0.05)

    fired: list[int] = []
    monkeypatch.setattr(parameters, "read_drone", busy)
    try:
        code, out, err = command("drone crazyflie")
    finally:
        gc.callbacks.remove(collecting)
    assert (code, out, fired) == (130, "", [1])
    assert err.strip().startswith("maidenflight: interrupted")


@pytest.mark.usefixtures("hears_ctrl_c")
@pytest.mark.parametrize("sent", [True, False])
def test_ctrl_c_that_an_extension_module_turns_into_an_import_error_is_not_lost(
    sent: bool, monkeypatch: Any, command: Command
) -> None:
    """As jaxlib does when it falls into its start; an import that fails by itself stays what it
    is."""

    def importing(*_given: Any) -> None:
        try:
            if sent:
                signal.raise_signal(signal.SIGINT)
        finally:
            raise ImportError("Encountered an error while initializing the extension.")

    monkeypatch.setattr(parameters, "read_drone", importing)
    before = signal.getsignal(signal.SIGINT)
    if sent:
        code, out, err = command("drone crazyflie")
        assert (code, out) == (130, "")
        assert err.strip().startswith("maidenflight: interrupted")
    else:
        with pytest.raises(ImportError, match="initializing"):
            command("drone crazyflie")
    assert signal.getsignal(signal.SIGINT) is before


_BUSY = """
import hashlib, pathlib, signal, sys, tempfile, threading, time
from maidenflight import __main__, parameters

signal.signal(signal.SIGINT, signal.default_int_handler)

def in_threads(*_):
    threading.Thread(target=hashlib.pbkdf2_hmac, args=("sha256", b"", b"", 10**9)).start()
    print("busy", flush=True)
    time.sleep(60)

def importing(*_):
    folder = pathlib.Path(tempfile.mkdtemp())
    swallows = ["print('busy', flush=True)", "try:", "    while 1: pass", "except: pass"]
    (folder / "slow_module.py").write_text("\\n".join(swallows))
    sys.path.insert(0, str(folder))
    import slow_module

parameters.read_drone = {what}
sys.argv = ["maidenflight", "drone", "crazyflie"]
__main__.main()
"""


@pytest.mark.parametrize("what", ["in_threads", "importing"])
def test_ctrl_c_ends_a_process_that_does_not_answer(what: str) -> None:
    """As in a compilation in another thread, for which Python's own end would wait; or that imports
    a module which swallows what is raised in it."""
    process = subprocess.Popen(
        [sys.executable, "-c", _BUSY.replace("{what}", what)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "busy\n"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=300)
    assert (process.returncode, out, len(err.strip().splitlines())) == (130, "", 1)
    assert err.strip().startswith("maidenflight: interrupted")
