"""A policy for other programs."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax

from maidenflight import manifest, parameters, results
from maidenflight.deployment import EXPORTERS
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.parameters import Parameters
from maidenflight.policy import INSTANTS, untrained
from maidenflight.simulator.interface import ControlInterface
from maidenflight.simulator.look_ahead import NONE, LookAhead
from maidenflight.simulator.mixing import mixer_of
from maidenflight.simulator.raptor_form import RAPTOR
from maidenflight.workflow.policies import frame_of, hover_of, read_as


def export(
    path: StrPath,
    folder: StrPath,
    seed: int,
    to: str = "c",
    structure: str | None = None,
    propellers: str | None = None,
) -> list[Path]:
    """Writes a policy, ours or the authors', for other programs.

    Args:
        path: policy file.
        folder: where to write; made if missing.
        seed: of random numbers in what is written, such as observations of a self-test.
        to: a name in `deployment.EXPORTERS`.
        structure: what an authors' policy commands; what its file's name says unless given.
        propellers: of the drone, where the exporter takes them; its default unless given.

    Returns:
        The files written.

    Raises:
        InputError: the file is no policy, or one of ours of another structure; or what is written
            cannot hold it, or not fly the frame that it was trained for.
    """
    exporter = EXPORTERS[to]
    policy = read_as(path, structure)
    chosen = {} if propellers is None else {"propellers": propellers}
    frame = frame_of(path)
    if frame is not None:
        drone = parameters.replace(parameters.crazyflie(), **frame)
        _must_be_mixed(to, policy.interface, parameters.check(drone, str(path)))
    record = results.record(
        seed=seed if "seed" in exporter.takes else None,
        inputs=[path],
        settings={
            "to": to,
            "control": policy.interface.name,
            **chosen,
            **({} if frame is None else {"rotors": frame}),
        },
    )
    given: dict[str, Any] = {
        "name": Path(path).stem,
        "hover": hover_of(path),
        "seed": seed,
        "record": record,
        **chosen,
    }
    written = exporter(policy, folder, **given)
    manifest.append(folder, "export", {"exported": written}, record, {"policies": [path]})
    return written


def export_options(path: StrPath, structure: str | None = None) -> tuple[str, ...]:
    """Options of the command `export` that a policy needs for its form.

    Args:
        path: policy file, ours or the authors'.
        structure: see `export`.

    Raises:
        InputError: the file is no policy.
    """
    return ("--to", RAPTOR) if read_as(path, structure).form == RAPTOR else ()


def _must_be_mixed(to: str, interface: ControlInterface, drone: Parameters) -> None:
    """Refuses a policy whose commands the Crazyflie's firmware would mix for another frame."""
    if to == "crazyflie" and interface.name != "pwm" and mixer_of(drone) is not None:
        raise InputError(
            f"policy: {interface.name} control of rotors at x = {drone.rotor_x.tolist()} m, y = "
            f"{drone.rotor_y.tolist()} m with directions {drone.rotor_direction.tolist()}, but the "
            "Crazyflie's firmware mixes for an X whose front right rotor turns counter-clockwise. "
            "Train PWM control, which commands the motors themselves, or export to c or onnx."
        )


def check_export(
    to: str,
    interface: ControlInterface,
    hidden: tuple[int, ...],
    history: int,
    drone: Parameters,
    look_ahead: LookAhead = NONE,
    memory: int = 0,
    form: str = INSTANTS,
) -> None:
    """Checks before a training that its policies can be exported: exports an untrained one.

    Args:
        to: a name in `deployment.EXPORTERS`.
        interface: of the policies.
        hidden: sizes of their hidden layers.
        history: number of instants in their observation.
        drone: that they are trained for.
        look_ahead: points of the reference ahead of time in it.
        memory: numbers that they remember.
        form: theirs, one of `policy.FORMS`.

    Raises:
        InputError: what is written could not hold them, or not fly the drone.
    """
    _must_be_mixed(to, interface, drone)
    policy = untrained(jax.random.key(0), hidden, history, interface, look_ahead, memory, form)
    with TemporaryDirectory() as folder:
        EXPORTERS[to](policy, folder, name="policy", seed=0)
