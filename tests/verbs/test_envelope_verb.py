"""`Envelope` goes on where it was interrupted."""

from pathlib import Path
from typing import Any

import jax
import polars
import pytest

from maidenflight import policy, policy_file
from maidenflight.errors import InputError
from maidenflight.experiments import envelope
from maidenflight.verbs.envelope import Envelope
from run_listing import entries


def test_an_envelope_goes_on_where_it_was_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown: list[tuple[str, str]] = []

    def one(policies: Any, reality: Any, axis: str, *, names: Any, **_: Any) -> polars.DataFrame:
        if len(flown) == 2:
            raise KeyboardInterrupt
        flown.append((reality.name, axis))
        rows = {"policy": list(names), "reality": reality.name, "axis": axis, "flight": [1]}
        rows |= {"reached": 0.5, "unit": "m/s", "hardest": 1.0, "limit": float("nan")}
        return polars.DataFrame(rows)

    monkeypatch.setattr(envelope, "envelope", one)
    path = policy_file.write_policy(
        tmp_path / "policy_1.json", policy.untrained_policy(jax.random.key(0))
    )

    def asked(resume: bool, flights: int = 20) -> polars.DataFrame:
        verb = Envelope(
            policies=(str(path),),
            reality=("virtual:7", "virtual:8"),
            along=("circle", "latency"),
            flights=flights,
            resume=resume,
        )
        return verb.run(tmp_path / "out").value

    with pytest.raises(KeyboardInterrupt):
        asked(resume=False)
    first = list(flown)
    flown.clear()
    table = asked(resume=True)
    assert entries(tmp_path) == {("envelope", "out"): {"envelope", "picture"}}
    assert first + flown == [
        (place, axis) for place in ("virtual:7", "virtual:8") for axis in ("circle", "latency")
    ]
    assert list(zip(table["reality"], table["axis"], strict=True)) == first + flown
    assert (tmp_path / "out" / "envelope.svg").read_text().startswith("<svg")
    with pytest.raises(InputError, match="of other policies, settings"):
        asked(resume=True, flights=5)
