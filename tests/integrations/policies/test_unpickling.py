"""A file of Stable-Baselines3 is read without running what it names."""

import base64
import collections
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.integrations.policies.unpickling import objects_of, unpickled


class Trap:
    """Pickled, it calls what it was given."""

    def __init__(self, *call: Any) -> None:
        self.call = call

    def __reduce__(self) -> Any:
        function, *rest = self.call
        return function, tuple(rest)


def model(folder: Path, **objects: Any) -> Path:
    data = {
        name: {":type:": "x", ":serialized:": base64.b64encode(pickle.dumps(one)).decode()}
        for name, one in objects.items()
    }
    with zipfile.ZipFile(folder / "model.zip", "w") as file:
        file.writestr("data", json.dumps({**data, "n_steps": 64}))
    return folder / "model.zip"


@pytest.mark.parametrize(
    "call",
    [(open, "{tmp}/touched", "w"), (eval, "open('{tmp}/touched', 'w')"), (getattr, 1, "real")],
)
def test_code_in_a_pickle_is_refused_and_not_run(call: Any, tmp_path: Path) -> None:
    function, *rest = call
    trap = Trap(function, *(str(one).format(tmp=tmp_path) for one in rest))
    with pytest.raises(pickle.UnpicklingError, match="could run any code"):
        unpickled(pickle.dumps(trap))
    with pytest.raises(InputError, match=r"model\.zip: cannot be read without running code"):
        objects_of(model(tmp_path, observation_space=trap), ())
    assert not (tmp_path / "touched").exists()


def test_numbers_and_collections_come_through_and_what_is_unused_stays_unread(
    tmp_path: Path,
) -> None:
    held = {"mean": np.arange(3.0), "count": np.float64(4), "names": collections.OrderedDict(a=1)}
    path = model(tmp_path, running=held, lr_schedule=Trap(print, "never"))
    (found,) = objects_of(path, ("lr_schedule",)).values()
    assert found["count"] == 4.0
    np.testing.assert_array_equal(found["mean"], held["mean"])
    generator = unpickled(pickle.dumps(np.random.default_rng(3)))
    assert generator.random() == np.random.default_rng(3).random()


def test_spaces_come_through() -> None:
    spaces = pytest.importorskip("gymnasium").spaces
    box = spaces.Box(-1.0, 1.0, (4,))
    assert unpickled(pickle.dumps(box)) == box
