"""`Export`: what is written says how it was made, and is refused where it would not fly."""

import json
from pathlib import Path

import jax
import pytest

from maidenflight import policy, policy_file
from maidenflight.deployment import keywords_of
from maidenflight.deployment.check import check_export
from maidenflight.errors import InputError
from maidenflight.parameters import GEOMETRY, crazyflie, plain, plus_frame, read_drone, replace
from maidenflight.registry import EXPORTERS
from maidenflight.simulator.controllers import control
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.verbs.export import Export
from maidenflight.verbs.parts.in_realities import export_command

RECORDED = [name for name in EXPORTERS.own if "record" in keywords_of(name)]


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
    made = policy.untrained_policy(jax.random.key(0), interface, spec)
    app = Export(policy=path, to="crazyflie")
    for drone in (own, other):
        rotors = {name: plain(getattr(drone, name)) for name in GEOMETRY}
        policy_file.write_policy(path, made, {"rotors": rotors})
        if drone is own or structure == "pwm":
            assert app.run(tmp_path / f"app{drone is own}").value
            check_export("crazyflie", interface, spec, drone)
            continue
        with pytest.raises(InputError, match="mixes for an X"):
            app.run(tmp_path / "no")
        with pytest.raises(InputError, match="mixes for an X"):
            check_export("crazyflie", interface, spec, drone)
        written = Export(policy=path).run(tmp_path / "c").value
        assert any("rotor_x" in file.read_text() for file in written)


def test_the_app_is_not_made_for_the_brushless_which_is_another_platform() -> None:
    interface, spec = control.pwm().interface, PolicySpec(hidden=(8,))
    brushless = read_drone("crazyflie_brushless")
    with pytest.raises(InputError, match=r"platform cf21bl.*Export to c"):
        check_export("crazyflie", interface, spec, brushless)
    check_export("c", interface, spec, brushless)


def test_an_app_is_exported_for_the_drone_s_propellers(tmp_path: Path) -> None:
    path = policy_file.write_policy(
        tmp_path / "policy_1.json", policy.untrained_policy(jax.random.key(0)), {}
    )
    Export(policy=path, to="crazyflie", propellers="legacy").run(tmp_path / "app")
    assert "LEGACY_PROPELLERS=y" in (tmp_path / "app" / "app-config").read_text()
    assert '"propellers": "legacy"' in (tmp_path / "app" / "src" / "policy.h").read_text()


@pytest.mark.parametrize("to", RECORDED)
def test_what_is_exported_says_how_it_was_made(to: str, tmp_path: Path) -> None:
    """Of a policy's file whose structure nobody names."""
    made = policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(8, 8)))
    if to == "raptor":
        pytest.importorskip("h5py")
        made = policy.untrained_policy(jax.random.key(0), spec=PolicySpec(form=to))
    path = policy_file.write_policy(tmp_path / "policy_1.json", made)
    written = Export(policy=path, to=to).run(tmp_path / "out").value
    texts = [b" ".join(path.read_bytes().replace(b"\n *", b" ").split()) for path in written]
    recorded = [text for text in texts if b"policy_1.json sha256" in text]
    assert recorded
    assert all(json.dumps({"to": to, "control": "pwm"}).encode() in text for text in recorded)


def test_doubts_of_the_drone_that_a_policy_was_trained_for_are_repeated(tmp_path: Path) -> None:
    made = policy.untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(8, 8)))
    record = {"doubts": ["mine.toml: a.csv: No flight."]}
    path = policy_file.write_policy(tmp_path / "policy_1.json", made, record)
    notes = Export(policy=path).run(tmp_path / "out").notes
    assert list(notes) == record["doubts"]


def test_a_policy_of_raptors_form_is_exported_for_its_programs() -> None:
    path = Path("policy_1.json")
    for form, options in (("raptor", ("--to", "raptor")), ("instants", ())):
        made = policy.untrained_policy(jax.random.key(0), spec=PolicySpec(form=form))
        assert export_command(path, made) == ("export", path, *options)
