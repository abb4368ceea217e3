"""What goes from file to file along the line."""

import dataclasses
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import polars
import pytest
from maidenflight.workflow import logs
from maidenflight.workflow.deployment import check_export

import maidenflight as mf
from commands import run
from flights.made_flights import calm, driven
from flying_policy import flown, flying_policy
from maidenflight import manifest, policy, policy_file, results, workflow
from maidenflight.deployment import EXPORTERS
from maidenflight.errors import InputError
from maidenflight.experiments import envelope
from maidenflight.flights import log
from maidenflight.flights.reading import Flights, read_flights
from maidenflight.identification import drone_file
from maidenflight.identification.closed_loop import Match
from maidenflight.identification.drone_file import DroneFile, Estimate, Search, Source
from maidenflight.parameters import GEOMETRY, crazyflie, plain, plus_frame, replace
from maidenflight.policy import Policy, untrained
from maidenflight.simulator import control, dynamics, tasks
from maidenflight.simulator.any_drone import AnyDay, AnyDrone
from maidenflight.simulator.control import Controller
from maidenflight.simulator.look_ahead import LookAhead
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.virtual_drone import virtual_drone
from maidenflight.training.analytic_gradient import AnalyticGradient
from maidenflight.training.evaluation import Evaluation
from maidenflight.training.ppo_settings import PPO
from maidenflight.training.train import Progress


def test_how_logs_were_read_stands_in_the_drone_file_s_record(
    tmp_path: Path, monkeypatch: Any
) -> None:
    reading = workflow.Reading(60.0, "subsampled", "legacy propellers", ("rotor_speed",))
    asked: list[Any] = []

    def read(*arguments: Any) -> Flights:
        asked.extend(arguments)
        return Flights((), (), ())

    def identify(*_: Any, **__: Any) -> Any:
        return SimpleNamespace(
            objective="likelihood",
            estimates={},
            search=polars.DataFrame({"trial": [1], "objective": [0.0]}),
            write=lambda path, record: DroneFile(crazyflie(), record=record).write(path),
        )

    monkeypatch.setattr("maidenflight.workflow.logs.read_flights", read)
    monkeypatch.setattr("maidenflight.workflow.logs.identify", identify)
    monkeypatch.setattr("maidenflight.workflow.logs.identification_picture", lambda *_: "")
    workflow.identify_from(tmp_path, 0, tmp_path / "drone.toml", reading=reading)
    assert asked[2:] == [60.0, 100, "subsampled", "legacy propellers", ("rotor_speed",)]
    made = drone_file.read(tmp_path / "drone.toml").record["settings"]
    assert {name: made[name] for name in reading.settings} == {
        "most_seconds": 60.0,
        "commands": "subsampled",
        "battery_law": "legacy propellers",
        "ignore": ["rotor_speed"],
    }
    workflow.identify_from(tmp_path, 0, tmp_path / "drone.toml")
    made = drone_file.read(tmp_path / "drone.toml").record["settings"]
    assert not {"commands", "battery_law", "ignore"} & set(made)


def test_logs_of_any_format_are_told_and_converted(
    tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    log.write(tmp_path / "logs" / "one.csv", driven())
    (tmp_path / "logs" / "bad.csv").write_text("x,y\n1,2\n")
    converted = tmp_path / "converted"
    code, out, _ = run(monkeypatch, capsys, "log", tmp_path / "logs", "-o", converted, "--json")
    told = json.loads(out)
    assert code == 0
    (one,) = told["logs"]
    assert (one["pieces"], one["rate"], one["seconds"]) == (1, 100.0, 9.0)
    assert told["dropped"] or told["refused"]
    (written,) = told["written"]
    (back,), (before,) = read_flights(written), read_flights(tmp_path / "logs")
    for group, values in before.arrays.items():
        np.testing.assert_allclose(back.arrays[group], values, atol=1e-6)
    record = results.read_record(Path(written))
    assert record is not None
    assert "one.csv" in str(results.recorded_inputs(record, "one.csv"))
    assert unlisted(tmp_path) == {"logs/one.csv", "logs/bad.csv"}
    (entry,) = manifest.read_manifest(tmp_path).entries
    assert entry.inputs["logs"][0].startswith("logs/one.csv sha256:")
    code, _, err = run(monkeypatch, capsys, "log", tmp_path / "logs", "-o", converted)
    assert code == 2
    assert "--overwrite" in err
    code, out, _ = run(monkeypatch, capsys, "log", tmp_path / "logs")
    assert code == 0
    assert "one.csv" in out


def test_the_mass_is_asked_for_where_nobody_gave_it(tmp_path: Path) -> None:
    real, simulated = (Flights((calm(simulated=name),), (), ()) for name in ("", "virtual drone 7"))
    DroneFile(crazyflie()).write(tmp_path / "mine.toml")
    mine = str(tmp_path / "mine.toml")
    assert "27 g" in workflow.Start("crazyflie_2.0").notes(real)[0]
    for start, flights in (
        (workflow.Start("crazyflie_2.0"), simulated),
        (workflow.Start("crazyflie_2.0", 0.03), real),
        (workflow.Start("crazyflie_bolt", 0.1), real),
        (workflow.Start(mine), real),
    ):
        assert start.notes(flights) == []
    assert float(workflow.Start(mine, 0.031).read().parameters.mass) == np.float32(0.031)
    assert float(workflow.Start("crazyflie", 0.031).read().parameters.mass) == np.float32(0.031)


def test_another_battery_law_than_the_drone_s_is_said(tmp_path: Path) -> None:
    """Also that a drone from anywhere else is left alone."""
    record = {"settings": {"battery_law": "legacy propellers"}}
    source = Source(3, 90.0, False, "subsampled", 65535.0)
    same = workflow.Reading(battery_law="legacy propellers")
    for file, reading, notes in (
        (DroneFile(crazyflie(), source=source, record=record), same, 0),
        (DroneFile(crazyflie(), source=source, record=record), workflow.Reading(), 1),
        (DroneFile(crazyflie(), source=source), same, 1),
        (DroneFile(crazyflie()), same, 0),
        (DroneFile(crazyflie(), source=source, record={"settings": 3}), same, 1),
    ):
        assert len(logs._other_law(file, reading)) == notes


def no_training(
    task: Any, controller: Controller, *_: Any, on_progress: Any, **__: Any
) -> tuple[Policy]:
    """In the place of training: a policy that knows nothing."""
    on_progress(Progress(1, 1, Evaluation(*jnp.zeros((3, 1)))))
    return (policy.untrained(jax.random.key(0), controller.interface, PolicySpec(hidden=(8, 8))),)


def test_what_a_command_of_one_is_goes_from_the_drone_s_logs_to_the_exported_code(
    tmp_path: Path, monkeypatch: Any
) -> None:
    """The README's `export_c` of a policy trained for an identified drone, without further words,
    and the app of its file."""
    source = Source(3, 90.0, False, "subsampled", 65535.0)
    search = Search("likelihood", -15.0, 80, 3)
    DroneFile(crazyflie(), source=source, search=search).write(tmp_path / "drone.toml")

    monkeypatch.setattr("maidenflight.workflow.training.train", no_training)
    (made,) = workflow.train_for(
        tmp_path / "drone.toml", 0, tmp_path, 1, workflow.SETTINGS["pwm"], 0.1
    )
    header, _ = mf.export_c(made, tmp_path / "c")
    assert "65535 of the firmware's 65535 counts" in " ".join(
        header.read_text().replace("\n *", " ").split()
    )
    workflow.export(tmp_path / "policy_1.json", tmp_path / "app", 0, "crazyflie")
    app = (tmp_path / "app" / "src" / "maidenflight.c").read_text()
    assert "static float full = 65535.0f;" in app
    share = re.search(
        r"^#define MF_HOVER (\S+)f ",
        (tmp_path / "app" / "src" / "policy.h").read_text(),
        re.MULTILINE,
    )
    assert share is not None
    hovers = float(dynamics.hover_command(crazyflie()))
    assert float(share[1]) == pytest.approx(hovers, abs=1e-6)


@pytest.mark.parametrize("ahead", [LookAhead(), LookAhead(2, 0.2)])
def test_a_look_ahead_is_trained_with_and_recorded(
    tmp_path: Path, monkeypatch: Any, ahead: LookAhead
) -> None:
    spec = PolicySpec(look_ahead=ahead, hidden=(8,))

    def untrained(*given: Any, on_progress: Any, **__: Any) -> tuple[Policy]:
        on_progress(Progress(1, 1, Evaluation(*jnp.zeros((3, 1)))))
        assert given[-1] == spec
        return (policy.untrained(jax.random.key(0), spec=spec),)

    monkeypatch.setattr("maidenflight.workflow.training.train", untrained)
    workflow.train_for("crazyflie", 0, tmp_path, 1, workflow.SETTINGS["pwm"], 0.1, spec=spec)
    file = tmp_path / "policy_1.json"
    assert policy_file.read(file).spec.look_ahead == ahead
    told = {"look_ahead": {"points": 2, "spacing": 0.2}} if ahead.points else {}
    settings = policy_file.read(file).record["settings"]
    assert {name: settings[name] for name in settings if "ahead" in name} == told


@pytest.mark.parametrize("structure", control.CONTROLLERS)
@pytest.mark.parametrize("method", ["gradient", "ppo"])
def test_the_usual_network_of_every_structure_can_be_exported_to_everything(
    structure: str, method: str
) -> None:
    for task in tasks.TASKS:
        _, spec = workflow.settings_for(structure, task, method)
        for to in set(EXPORTERS) - {"raptor"}:
            check_export(to, control.CONTROLLERS[structure]().interface, spec, crazyflie())


def test_attitude_control_is_trained_about_hovering_unless_the_papers_scales_are_asked_for() -> (
    None
):
    """A drone that hovers below 7/12 of full thrust cannot descend with the paper's."""
    drone = DroneFile(replace(crazyflie(), thrust_to_weight=2.5))
    hovers = float(dynamics.hover_command(drone.parameters))
    made = workflow.controller_to_train("attitude", drone).interface
    least, most = (made.centre[0] + sign * made.span[0] for sign in (-1, 1))
    assert least < hovers - 0.2
    assert most > hovers + 0.2
    alike = DroneFile(replace(crazyflie(), thrust_to_weight=2.51))
    assert workflow.controller_to_train("attitude", alike).interface == made
    papers = workflow.controller_to_train("attitude", drone, paper_scales=True).interface
    assert papers == control.attitude().interface
    start = untrained(jax.random.key(0), interface=papers)
    assert workflow.controller_to_train("attitude", drone, start).interface == papers
    for structure in control.CONTROLLERS:  # which training then refuses
        other = control.CONTROLLERS[structure](full_scale_counts=65535).interface
        start = untrained(jax.random.key(0), interface=other)
        assert workflow.controller_to_train(structure, drone, start).interface != other
    assert (
        workflow.controller_to_train("pwm", drone).interface
        == control.pwm(full_scale_counts=drone.full_scale_counts).interface
    )


@pytest.mark.parametrize(
    ("target", "paper_scales", "papers"),
    [("authors", False, True), ("c", False, False), (None, True, True)],
)
def test_policies_for_the_authors_format_have_the_papers_scales(
    tmp_path: Path, monkeypatch: Any, target: str | None, paper_scales: bool, papers: bool
) -> None:
    monkeypatch.setattr("maidenflight.workflow.training.train", no_training)
    (made,) = workflow.train_for(
        *("crazyflie", 0, tmp_path, 1, workflow.SETTINGS["attitude"], 0.1),
        structure="attitude",
        target=target,
        paper_scales=paper_scales,
    )
    assert (made.interface == control.attitude().interface) == papers
    said = policy_file.read(tmp_path / "policy_1.json").record["settings"]
    assert said.get("paper_scales") == (papers or None)


def test_attitude_rate_fits_a_crazyflie_with_four_instants() -> None:
    _, spec = workflow.settings_for("attitude_rate", "circle", history=4)
    assert (spec.history, spec.hidden) == (4, (75, 75))
    check_export("crazyflie", control.attitude_rate().interface, spec, crazyflie())


@pytest.mark.parametrize("structure", control.CONTROLLERS)
def test_gradients_see_most_of_a_second_ahead_and_with_a_memory_no_less(structure: str) -> None:
    rate = control.CONTROLLERS[structure]().interface.rate
    usual, remembering = (
        workflow.settings_for(structure, "circle", "gradient", memory=size)[0] for size in (0, 16)
    )
    assert 0.6 < usual.horizon / rate < 0.85
    assert remembering.horizon / rate > 0.6
    assert remembering.updates >= usual.updates


def test_drones_of_any_make_are_trained_over_with_a_memory_and_its_own_settings() -> None:
    drones = workflow.randomized("crazyflie", workflow.ANY, control.pwm())
    assert isinstance(drones, AnyDrone)
    assert float(drones.centre.mass) == pytest.approx(float(crazyflie().mass))
    assert isinstance(workflow.randomized("crazyflie", workflow.ANY_DAY, control.pwm()), AnyDay)
    usual, own = (
        workflow.settings_for("pwm", "circle", "gradient", memory=size)[0] for size in (0, 16)
    )
    assert isinstance(usual, AnalyticGradient)
    assert isinstance(own, AnalyticGradient)
    assert own.hidden_learning_rate < usual.hidden_learning_rate
    assert own.updates == usual.updates
    assert workflow.settings_for("pwm", "circle", "ppo", memory=16) == (
        PPO(),
        PolicySpec(memory=16),
    )
    start = untrained(jax.random.key(0), spec=PolicySpec(memory=16, hidden=(24, 12)))
    tuned, spec = workflow.settings_for("pwm", "circle", initial=start)
    assert isinstance(tuned, AnalyticGradient)
    assert (spec, tuned.num_envs) == (start.spec, own.num_envs)
    assert tuned.learning_rate < own.learning_rate
    raptor, spec = workflow.settings_for("pwm", "circle", "gradient", form="raptor")
    assert raptor == dataclasses.replace(own, learning_rate=2e-3)
    assert (spec, spec.hidden) == (PolicySpec(form="raptor"), (16,))
    assert tuned.updates < own.updates


def test_a_crazyflie_takes_a_policy_that_remembers_16_numbers_and_the_authors_file_none() -> None:
    interface = control.pwm().interface
    for target in ("crazyflie", "c", "onnx"):
        check_export(target, interface, PolicySpec(memory=16), crazyflie())
    with pytest.raises(InputError, match="memory = 16, but the authors' policies"):
        check_export("authors", interface, PolicySpec(memory=16), crazyflie())
    with pytest.raises(InputError, match="multiplications"):
        check_export("crazyflie", interface, PolicySpec(memory=64), crazyflie())


@pytest.mark.parametrize("structure", control.CONTROLLERS)
def test_an_app_for_the_firmwares_mixer_is_not_made_of_a_policy_for_another_frame(
    structure: str, tmp_path: Path
) -> None:
    interface = control.CONTROLLERS[structure]().interface
    own, other = crazyflie(), replace(crazyflie(), **plus_frame(0.05))
    path, spec = tmp_path / "policy.json", PolicySpec(hidden=(8,))
    made = policy.untrained(jax.random.key(0), interface, spec)
    for drone in (own, other):
        rotors = {name: plain(getattr(drone, name)) for name in GEOMETRY}
        policy_file.write(path, made, {"rotors": rotors})
        if drone is own or structure == "pwm":
            assert workflow.export(path, tmp_path / f"app{drone is own}", 0, "crazyflie")
            check_export("crazyflie", interface, spec, drone)
            continue
        with pytest.raises(InputError, match="mixes for an X"):
            workflow.export(path, tmp_path / "no", 0, "crazyflie")
        with pytest.raises(InputError, match="mixes for an X"):
            check_export("crazyflie", interface, spec, drone)
        written = workflow.export(path, tmp_path / "c", 0, "c")
        assert any("rotor_x" in file.read_text() for file in written)


def test_what_the_target_could_not_hold_is_not_trained(tmp_path: Path, monkeypatch: Any) -> None:
    def trained(*_: Any, **__: Any) -> None:
        raise AssertionError("training began")

    monkeypatch.setattr("maidenflight.workflow.training.train", trained)
    settings, spec = workflow.settings_for("pwm", "circle", hidden=(128, 128))
    assert spec.hidden == (128, 128)
    asked: Any = ("crazyflie", 0, tmp_path, 1, settings, 0.1)
    with pytest.raises(InputError, match="22016 multiplications"):
        workflow.train_for(*asked, spec=spec, target="crazyflie")
    with pytest.raises(InputError, match=r"look_ahead = .*2.*, but the authors' policies"):
        workflow.train_for(*asked, spec=PolicySpec(look_ahead=LookAhead(2)), target="authors")
    with pytest.raises(AssertionError, match="training began"):
        workflow.train_for(*asked, spec=spec, target="c")
    assert not list(tmp_path.iterdir())


def test_an_app_is_exported_for_the_drone_s_propellers(tmp_path: Path) -> None:
    policy_file.write(tmp_path / "policy_1.json", policy.untrained(jax.random.key(0)), {})
    workflow.export(
        tmp_path / "policy_1.json", tmp_path / "app", 0, "crazyflie", propellers="legacy"
    )
    assert "LEGACY_PROPELLERS=y" in (tmp_path / "app" / "app-config").read_text()
    assert '"propellers": "legacy"' in (tmp_path / "app" / "src" / "policy.h").read_text()


RECORDED = [name for name, exporter in EXPORTERS.items() if "record" in exporter.takes]


@pytest.mark.parametrize("to", RECORDED)
def test_what_is_exported_says_how_it_was_made(to: str, tmp_path: Path) -> None:
    """Of a policy's file whose structure nobody names."""
    made = policy.untrained(jax.random.key(0), spec=PolicySpec(hidden=(8, 8)))
    if to == "raptor":
        pytest.importorskip("h5py")
        made = policy.untrained(jax.random.key(0), spec=PolicySpec(form=to))
    policy_file.write(tmp_path / "policy_1.json", made)
    written = workflow.export(tmp_path / "policy_1.json", tmp_path / "out", 0, to)
    texts = [b" ".join(path.read_bytes().replace(b"\n *", b" ").split()) for path in written]
    recorded = [text for text in texts if b"policy_1.json sha256" in text]
    assert recorded
    assert all(json.dumps({"to": to, "control": "pwm"}).encode() in text for text in recorded)


def test_an_envelope_goes_on_where_it_was_interrupted(tmp_path: Path, monkeypatch: Any) -> None:
    flown: list[tuple[str, str]] = []

    def one(policies: Any, reality: Any, axis: str, *, names: Any, **_: Any) -> polars.DataFrame:
        if len(flown) == 2:
            raise KeyboardInterrupt
        flown.append((reality.name, axis))
        rows = {"policy": list(names), "reality": reality.name, "axis": axis, "flight": [1]}
        rows |= {"reached": 0.5, "unit": "m/s", "hardest": 1.0, "limit": float("nan")}
        return polars.DataFrame(rows)

    monkeypatch.setattr("maidenflight.workflow.envelope.envelope.envelope", one)
    policy_file.write(tmp_path / "policy_1.json", policy.untrained(jax.random.key(0)))
    places = [virtual_drone(7), virtual_drone(8)]

    def asked(resume: bool, flights: int = 20) -> polars.DataFrame:
        given = [tmp_path / "policy_1.json"], places, ("circle", "latency"), 0, tmp_path / "out"
        return workflow.envelope_of(*given, flights=flights, resume=resume)

    with pytest.raises(KeyboardInterrupt):
        asked(resume=False)
    first = list(flown)
    flown.clear()
    table = asked(resume=True)
    assert first + flown == [
        (place, axis) for place in ("virtual-7", "virtual-8") for axis in ("circle", "latency")
    ]
    assert list(zip(table["reality"], table["axis"], strict=True)) == first + flown
    assert (tmp_path / "out" / "envelope.svg").read_text().startswith("<svg")
    assert entries(tmp_path) == {("envelope", "out"): {"envelope", "picture"}}
    with pytest.raises(InputError, match="of other policies, settings"):
        asked(resume=True, flights=5)
    best = workflow.best_by_envelope(envelope.summary(table), [tmp_path / "policy_1.json"])
    assert best == tmp_path / "policy_1.json"


def test_the_closed_loop_moves_what_it_found_in_the_drone_file_and_keeps_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    start = tmp_path / "drone.toml"
    DroneFile(
        replace(crazyflie(), position_walk=np.float32(0.05)),
        {"latency": Estimate(0.018, (0.017, 0.019), (0.018,), 0.001)},
        {"latency": np.linspace(0.017, 0.019, 50), "drag_x": np.linspace(0.1, 0.2, 50)},
        Source(1, 4.0, True, "zero-order-hold", 60000.0),
        Search("likelihood", -10.0, 4, 9),
    ).write(start)
    flying = flying_policy(crazyflie())
    policy_file.write(
        tmp_path / "policies" / "policy_1.json",
        flying,
        results.record(seed=0, inputs=[], settings={}),
    )
    log.write(tmp_path / "logs" / "flight_1.csv", flown(flying, 1, 60))
    found = Match(
        crazyflie(),
        {"latency": (0.012, 0.001), "position_walk": (0.04, 0.002)},
        *(1, 1, np.full(7, 0.1), np.full(7, 0.01), (2.0, 1.0), 15),
    )
    seen: dict[str, Any] = {}

    def match(flights: Any, policies: Any, drones: Any, *rest: Any) -> Match:
        seen.update(flights=flights, policies=policies, walk=float(np.mean(drones.position_walk)))
        return found

    monkeypatch.setattr("maidenflight.workflow.closed_loop.match", match)
    arguments = (
        *("identify", tmp_path / "logs", tmp_path / "policies", "--objective", "closed_loop"),
        *("--start", start, "-o", tmp_path / "matched.toml"),
    )
    code, out, _ = run(monkeypatch, capsys, *arguments, "--json")
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
    assert entries(tmp_path) == {("identify", "matched.toml"): {"drone"}}
    assert set(manifest.read_manifest(tmp_path).entries[0].inputs) == {"logs", "policies", "drone"}
    code, out, _ = run(monkeypatch, capsys, *arguments, "--overwrite")
    assert code == 0
    assert "latency" in out
    others = tmp_path / "policies" / "policy_1.json"
    policy_file.write(
        others, untrained(jax.random.key(0)), results.record(seed=0, inputs=[], settings={})
    )
    code, _, said = run(monkeypatch, capsys, *arguments, "--overwrite")
    assert code == 2
    assert "none of 1 policies" in said


def test_a_log_of_the_day_tells_the_trims_and_nothing_else(tmp_path: Path) -> None:
    file = DroneFile(
        crazyflie(), {"torque_bias_z": Estimate(0.0, (-1e-4, 1e-4), (0.0,), 4e-5)}, name="mine"
    )
    noise = 0.01 * np.random.default_rng(0).standard_normal((300, 4))
    flight = calm(300, command=np.float32(noise + np.array([0.5, 0.54, 0.5, 0.54])))
    today = log.write(tmp_path / "today.csv", flight)
    drones = workflow.possible_drones(file, workflow.TRIMS, 0, today)
    assert np.mean(drones.torque_bias[:, 2]) < -1e-5
    assert np.ptp(drones.latency) == 0.0
    point = workflow.possible_drones(file, 0.0, 0, today)
    assert float(point.torque_bias[2]) == pytest.approx(np.mean(drones.torque_bias[:, 2]), rel=0.02)
    with pytest.raises(InputError, match="posterior"):
        workflow.possible_drones(file, workflow.POSTERIOR, 0, today)


def test_best_scores_are_those_of_the_policy_that_is_kept() -> None:
    heard = [
        Progress(1, 1, Evaluation(*(jnp.array([value, -value]) for _ in Evaluation._fields)))
        for value in (1.0, 3.0, 2.0)
    ]
    first, second = workflow.best_scores(heard, 2)
    assert set(first.values()) == {3.0}
    assert set(second.values()) == {-1.0}


def test_a_plant_is_refused_at_once_where_the_drone_changes_in_flight() -> None:
    assert callable(workflow.plant("virtual:1+yaw600", 0))
    with pytest.raises(InputError, match="virtual-1"):
        workflow.plant("virtual:1+yaw600@1", 0)


def test_a_policy_of_raptors_form_is_exported_for_its_programs(tmp_path: Path) -> None:
    for form, options in (("raptor", ("--to", "raptor")), ("instants", ())):
        path = tmp_path / f"{form}.json"
        policy_file.write(path, policy.untrained(jax.random.key(0), spec=PolicySpec(form=form)))
        assert workflow.export_options(path) == options
