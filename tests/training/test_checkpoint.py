import errno
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight import results
from maidenflight.errors import InputError, WriteError
from maidenflight.training import checkpoint


class State(NamedTuple):
    weights: Any
    number: Any


FULL = State(jnp.arange(6.0).reshape(2, 3), jnp.asarray(7, jnp.int32))


STAGES = (3, 9)


def fresh(_: Any = None) -> State:
    return State(jnp.zeros((2, 3)), jnp.zeros((), jnp.int32))


def test_a_state_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "training.npz"
    checkpoint.save(path, FULL, "mine", STAGES)
    heard: list[Any] = []

    def start(stages: Any) -> State:
        heard.append(stages)
        return fresh()

    found, stages = checkpoint.restored(path, start, "mine")
    assert stages == checkpoint.stages(path) == STAGES
    assert heard == [STAGES]
    np.testing.assert_array_equal(found.weights, FULL.weights)
    assert (int(found.number), found.number.dtype) == (7, jnp.int32)


def test_without_a_file_training_begins(tmp_path: Path) -> None:
    state, stages = checkpoint.restored(tmp_path / "none.npz", fresh, "mine")
    assert (int(state.number), stages) == (0, ())
    assert checkpoint.stages(tmp_path / "none.npz") == ()


@pytest.mark.parametrize(
    ("start", "told"),
    [
        (fresh, "yours"),
        (lambda _: fresh()._replace(weights=jnp.zeros((3, 2))), "mine"),
        (lambda _: fresh()._replace(number=jnp.zeros(())), "mine"),
    ],
)
def test_another_training_is_refused(start: Any, told: str, tmp_path: Path) -> None:
    checkpoint.save(tmp_path / "training.npz", FULL, "mine", STAGES)
    with pytest.raises(InputError, match=r"training\.npz: a checkpoint of another training"):
        checkpoint.restored(tmp_path / "training.npz", start, told)


def damaged(whole: bytes) -> dict[str, bytes]:
    return {
        "empty": b"",
        "cut": whole[: len(whole) // 2],
        "text": b"not an archive",
        "one byte": whole[:200] + bytes([whole[200] ^ 255]) + whole[201:],
    }


@pytest.mark.parametrize("how", ["empty", "cut", "text", "one byte"])
def test_a_damaged_file_is_refused(how: str, tmp_path: Path) -> None:
    path = tmp_path / "training.npz"
    checkpoint.save(path, FULL, "mine", STAGES)
    path.write_bytes(damaged(path.read_bytes())[how])
    with pytest.raises(InputError, match=r"training\.npz"):
        checkpoint.restored(path, fresh, "mine")
    with pytest.raises(InputError, match=r"training\.npz"):
        checkpoint.stages(path)


def test_code_in_a_file_is_not_run(tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> Any:
            return os.mkdir, (str(tmp_path / "boom"),)

    title = np.array("maidenflight checkpoint 2\n0\n3\nmine")
    with open(tmp_path / "training.npz", "wb") as file:
        np.savez(
            file,
            allow_pickle=True,
            title=title,
            **{"leaf 0": np.array([Bomb()]), "leaf 1": np.array(7)},
        )  # type: ignore[arg-type]
    with pytest.raises(InputError, match="not a checkpoint"):
        checkpoint.restored(tmp_path / "training.npz", fresh, "mine")
    assert not (tmp_path / "boom").exists()


def test_another_versions_file_is_refused(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(checkpoint, "__version__", "99.0")
    checkpoint.save(tmp_path / "training.npz", FULL, "mine", STAGES)
    monkeypatch.undo()
    with pytest.raises(InputError, match=r"a checkpoint of maidenflight 99\.0"):
        checkpoint.restored(tmp_path / "training.npz", fresh, "mine")


def test_a_full_disk_keeps_the_last_good_state(tmp_path: Path, monkeypatch: Any) -> None:
    path = tmp_path / "training.npz"
    checkpoint.save(path, FULL, "mine", STAGES)

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(WriteError, match=r"No space left on device\)\. Free space there, or"):
        checkpoint.save(path, fresh(), "mine", STAGES)
    monkeypatch.undo()
    assert int(checkpoint.restored(path, fresh, "mine")[0].number) == 7
    assert list(tmp_path.iterdir()) == [path]


_KILLED = """
import os, signal, sys
from maidenflight import results
stage, content, path = sys.argv[1], open(sys.argv[2], "rb").read(), sys.argv[3]

def die(*arguments, **_):
    if stage == "fdopen":  # half of the content is there
        os.write(arguments[0], content[: len(content) // 2])
    os.kill(os.getpid(), signal.SIGKILL)

setattr(os, stage, die)
results.write(path, content)
"""


@pytest.mark.parametrize(
    ("stage", "expected"),
    [("fdopen", 7), ("fsync", 7), ("chmod", 7), ("replace", 7), ("unlink", 0)],
)
def test_whenever_a_writing_process_is_killed_the_file_is_the_old_or_the_new_one(
    stage: str, expected: int, tmp_path: Path
) -> None:
    path, new = tmp_path / "there" / "training.npz", tmp_path / "new.npz"
    checkpoint.save(path, FULL, "mine", STAGES)
    checkpoint.save(new, fresh(), "mine", STAGES)
    done = subprocess.run(
        [sys.executable, "-c", _KILLED, stage, new, path],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert int(checkpoint.restored(path, fresh, "mine")[0].number) == expected
    left = results.leftovers(path.parent)
    assert len(left) == (0 if expected == 0 else 1)
    assert sorted(path.parent.iterdir()) == sorted([path, *left])


def test_a_fingerprint_tells_words_and_numbers_apart() -> None:
    said = {"updates": 3}
    prints = {
        checkpoint.fingerprint(said, np.ones(2, np.float32)),
        checkpoint.fingerprint({"updates": 4}, np.ones(2, np.float32)),
        checkpoint.fingerprint(said, np.nextafter(np.ones(2, np.float32), np.float32(2))),
        checkpoint.fingerprint(said, np.ones(2, np.int32)),
        checkpoint.fingerprint(said, np.ones((1, 2), np.float32)),
    }
    assert len(prints) == 5
    assert checkpoint.fingerprint(said, FULL) == checkpoint.fingerprint(
        dict(said), State(*map(np.asarray, FULL))
    )


@pytest.mark.parametrize(
    ("stages", "evaluations", "ends"),
    [
        ((400,), 4, [100, 200, 300, 400]),
        ((5,), 3, [2, 3, 5]),
        ((2,), 15, [1, 2]),
        ((7,), 1, [7]),
        ((600, 700), 15, [*range(40, 601, 40), 650, 700]),
        ((4, 5, 9), 2, [2, 4, 5, 7, 9]),
        ((2, 4), 15, [1, 2, 3, 4]),
    ],
)
def test_the_last_score_of_a_stage_comes_at_its_end_whatever_divides_what(
    stages: tuple[int, ...], evaluations: int, ends: list[int]
) -> None:
    assert checkpoint.ends(stages, evaluations, from_zero=False) == ends
    assert checkpoint.ends(stages, evaluations, from_zero=True) == [0, *ends]
