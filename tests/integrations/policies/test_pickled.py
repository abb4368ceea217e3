"""A pickle is data: what it names is neither imported nor called."""

import collections
import pickle
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from maidenflight.integrations.policies.pickled import Made, array, read_pickle

FOLDER = Path(__file__).parent / "stable_baselines"


def evil_pickles(place: Path) -> dict[str, bytes]:
    """Pickles that write a file in as many ways as a pickle can call something."""
    code = f"open({str(place)!r}, 'w').close()"
    inner = b"cbuiltins\nexec\n" + b"(V" + code.encode() + b"\ntR."
    named = b"cstable_baselines3.common.vec_env.base_vec_env\nCloudpickleWrapper\n"
    return {
        "REDUCE": inner,
        "INST": b"(V" + code.encode() + b"\nibuiltins\nexec\n.",
        "OBJ": b"(cbuiltins\nexec\nV" + code.encode() + b"\no.",
        "NEWOBJ": b"\x80\x02cbuiltins\nexec\nV" + code.encode() + b"\n\x85\x81.",
        "NEWOBJ_EX": b"\x80\x04cbuiltins\nexec\nV" + code.encode() + b"\n\x85}\x92.",
        "STACK_GLOBAL": b"\x80\x04Vbuiltins\nVexec\n\x93V" + code.encode() + b"\n\x85R.",
        "BUILD": named + b")\x81" + b"B" + len(inner).to_bytes(4, "little") + inner + b"b.",
        "a name with dots": b"\x80\x04Vmaidenflight\nVos.system\n\x93Vtouch "
        + str(place).encode()
        + b"\n\x85R.",
        "CSVOutputFormat": b"cstable_baselines3.common.logger\nCSVOutputFormat\n(V"
        + str(place).encode()
        + b"\ntR.",
        "ResultsWriter": b"cstable_baselines3.common.monitor\nResultsWriter\n(V"
        + str(place).encode()
        + b"\ntR.",
    }


NAMES = list(evil_pickles(Path("x")))


@pytest.mark.parametrize("name", NAMES)
def test_what_a_pickle_calls_is_noted_and_not_called(name: str, tmp_path: Path) -> None:
    found = read_pickle(evil_pickles(tmp_path / "touched")[name])
    assert isinstance(found, Made)
    assert not (tmp_path / "touched").exists()
    with pytest.raises(ValueError):
        array(found)


def test_the_tries_are_no_blanks(tmp_path: Path) -> None:
    place = tmp_path / "touched"
    for name in ("REDUCE", "INST", "OBJ", "STACK_GLOBAL"):
        pickle.loads(evil_pickles(place)[name])
        assert place.exists(), name
        place.unlink()


def test_nothing_is_imported(tmp_path: Path) -> None:
    (tmp_path / "stranger.py").write_text(f"open({str(tmp_path / 'touched')!r}, 'w').close()\n")
    code = (
        "import sys; from maidenflight.integrations.policies.pickled import read_pickle\n"
        "before = set(sys.modules)\n"
        "found = read_pickle(b'cstranger\\nthing\\n)R.')\n"
        "print(found.name, set(sys.modules) - before)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == "stranger.thing set()\n"
    assert not (tmp_path / "touched").exists()


@pytest.mark.parametrize(
    "raw",
    [
        b"\x82\x01.",  # of a table of extensions, which holds objects
        b"\x80\x05\x97.",  # a buffer from outside
        b"P1\n.",
        b".",
        b"]",
        b"N" * 10 + b".",
        b"t.",
        b"NNb.",
        b"]Nb.",
        b"\x80\x04}]Ks.",
        b"j\xff\xff\xff\x7f.",
        b"\x96" + (2**62).to_bytes(8, "little") + b".",
        b"\x8e" + (2**62).to_bytes(8, "little") + b".",
        b"I" + b"9" * 5000 + b"\n.",
    ],
)
def test_what_is_no_sound_pickle_is_refused(raw: bytes) -> None:
    with pytest.raises(ValueError, match="not a pickle that is read"):
        read_pickle(raw)


def test_a_pickle_of_many_instructions_is_refused() -> None:
    with pytest.raises(ValueError, match="instructions"):
        read_pickle(b"N" * 20_000 + b".")


def test_a_far_place_in_the_memory_takes_none() -> None:
    assert read_pickle(b"Nr\xff\xff\xff\x7f.") is None


PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False)
    | st.text(max_size=8)
    | st.binary(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.tuples(inner, inner)
        | st.dictionaries(st.text(max_size=4), inner, max_size=4)
    ),
    max_leaves=12,
)


@pytest.mark.slow
@given(value=PLAIN, protocol=st.integers(0, 5))
def test_plain_values_come_through_in_every_protocol(value: Any, protocol: int) -> None:
    if protocol > 2 or not _has_bytes(value):  # before that, bytes are made by a call
        assert read_pickle(pickle.dumps(value, protocol)) == value


def _has_bytes(value: Any) -> bool:
    if isinstance(value, dict):
        value = list(value.values())
    return isinstance(value, bytes) or (
        isinstance(value, list | tuple) and any(map(_has_bytes, value))
    )


@given(raw=st.binary(max_size=60))
def test_random_bytes_are_read_or_refused(raw: bytes) -> None:
    with suppress(ValueError):
        read_pickle(raw)


@pytest.mark.parametrize("protocol", range(2, 6))
@pytest.mark.parametrize("kind", ["<f4", ">f8", "<i8", "|u1", "|b1"])
def test_arrays_come_through(kind: str, protocol: int) -> None:
    for shape in ((), (3,), (2, 3), (0, 4)):
        expected = np.arange(np.prod(shape, dtype=int)).reshape(shape).astype(kind)
        for one in (expected, np.asfortranarray(expected)):
            found = array(read_pickle(pickle.dumps(one, protocol)))
            np.testing.assert_array_equal(found, one)
            assert found.dtype == one.dtype
    assert array(read_pickle(pickle.dumps(np.float64(4.5), protocol))) == 4.5


@pytest.mark.parametrize("wrong", [np.array(["a"]), np.array([{}], object), np.zeros(2, "i4,f4")])
def test_arrays_of_other_things_are_refused(wrong: np.ndarray) -> None:
    with pytest.raises(ValueError, match="no array of numbers"):
        array(read_pickle(pickle.dumps(wrong)))


def test_an_array_that_says_another_shape_is_refused() -> None:
    held = read_pickle(pickle.dumps(np.zeros(3)))
    version, _, *rest = held.state
    for shape in ((10**12,), (4,), "x", (-3,)):
        held.state = (version, shape, *rest)
        with pytest.raises(ValueError, match="no array of numbers"):
            array(held)
    held.state = (version, (10**10,), *rest[:2], 10**10)
    with pytest.raises(ValueError, match="no bytes"):
        array(held)


def test_an_ordered_dictionary_keeps_its_entries() -> None:
    found = read_pickle(pickle.dumps(collections.OrderedDict(a=1, b=2)))
    assert (found.name, found.entries) == ("collections.OrderedDict", {"a": 1, "b": 2})
