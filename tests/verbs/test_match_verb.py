"""`Match` moves what it found in the drone's file."""

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from commands import Command
from flying_policy import flown, flying_policy
from maidenflight import manifest, policy_file, results
from maidenflight.flights import flight_csv
from maidenflight.identification import drone_file
from maidenflight.identification.closed_loop import Match
from maidenflight.identification.drone_file import DroneFile, Estimate, Search, Source
from maidenflight.identification.posterior import Posterior
from maidenflight.parameters import crazyflie, replace
from maidenflight.policy import untrained_policy
from run_listing import entries


def test_the_closed_loop_moves_what_it_found_in_the_drone_file_and_keeps_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    start = tmp_path / "drone.toml"
    DroneFile(
        replace(crazyflie(), position_walk=np.float32(0.05)),
        {"latency": Estimate(0.018, (0.017, 0.019), (0.018,), 0.001)},
        Posterior({"latency": np.linspace(0.017, 0.019, 50), "drag_x": np.linspace(0.1, 0.2, 50)}),
        Source(1, 4.0, True, "zero-order-hold", 60000.0),
        Search("likelihood", -10.0, 4, 9),
    ).write(start)
    flying = flying_policy(crazyflie())
    policy_file.write_policy(
        tmp_path / "policies" / "policy_1.json",
        flying,
        results.record(seed=0, inputs=[], settings={}),
    )
    flight_csv.write(tmp_path / "logs" / "flight_1.csv", flown(flying, 1, 60))
    found = Match(
        crazyflie(),
        {"latency": (0.012, 0.001), "position_walk": (0.04, 0.002)},
        *(1, 1, np.full(7, 0.1), np.full(7, 0.01), (2.0, 1.0), 15),
    )
    seen: dict[str, Any] = {}

    def match(flights: Any, policies: Any, drones: Any, *rest: Any) -> Match:
        seen.update(flights=flights, policies=policies, walk=float(np.mean(drones.position_walk)))
        return found

    monkeypatch.setattr("maidenflight.identification.closed_loop.match", match)
    places = f"{tmp_path}/logs {tmp_path}/policies --start {start} -o {tmp_path}/matched.toml"
    arguments = f"match {places}"
    code, out, _ = command(arguments, "--json")
    assert code == 0
    content = json.loads(out)
    assert content["parameters"]["latency"] == {"value": 0.012, "standard_error": 0.001}
    assert seen["walk"] == pytest.approx(0.05)
    assert {name: len(own) for name, own in seen["flights"].items()} == {"policy_1": 1}
    file = drone_file.read(tmp_path / "matched.toml")
    assert float(file.parameters.latency) == pytest.approx(0.012)
    assert float(file.parameters.position_walk) == pytest.approx(0.04)
    assert file.estimates["latency"].between_sd == 0.001
    assert file.estimates["latency"].interval == pytest.approx((0.01004, 0.01396))
    assert np.mean(file.posterior["latency"]) == pytest.approx(0.012, rel=1e-3)
    assert np.std(file.posterior["latency"]) == pytest.approx(0.001, rel=1e-3)
    np.testing.assert_allclose(file.posterior["drag_x"], np.linspace(0.1, 0.2, 50), rtol=1e-5)
    assert file.search == Search("closed_loop", 1.0, 1, 15)
    assert len(results.recorded_inputs(file.record, "x")) == 3
    assert entries(tmp_path) == {("match", "matched.toml"): {"drone"}}
    assert set(manifest.read_manifest(tmp_path).entries[0].inputs) == {"logs", "policies", "drone"}
    code, out, _ = command(arguments, "--overwrite")
    assert code == 0
    assert "latency" in out
    others = tmp_path / "policies" / "policy_1.json"
    policy_file.write_policy(
        others, untrained_policy(jax.random.key(0)), results.record(seed=0, inputs=[], settings={})
    )
    code, _, said = command(arguments, "--overwrite")
    assert code == 2
    assert "none of 1 policies" in said
