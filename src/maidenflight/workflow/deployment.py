"""A policy for other programs."""

from pathlib import Path

from maidenflight import results
from maidenflight.deployment.authors_json import export_authors_json
from maidenflight.deployment.c import export_c
from maidenflight.deployment.crazyflie import export_crazyflie
from maidenflight.deployment.onnx import export_onnx
from maidenflight.inputs import StrPath
from maidenflight.simulator.battery import COUNTS, MOST_COUNTS
from maidenflight.workflow.policies import read_as, trained_with


def export(
    path: StrPath, folder: StrPath, seed: int, to: str = "c", structure: str | None = None
) -> list[Path]:
    """Writes a policy, ours or the authors', for other programs.

    Args:
        path: policy file.
        folder: where to write; made if missing.
        seed: draws the observations of the C code's self-test.
        to: `c`: C99, `policy.h` and `policy.c`; `onnx`: `policy.onnx`; `authors`: a JSON as the
            authors' tools read it; `crazyflie`: an app for the Crazyflie's firmware.
        structure: what an authors' policy commands; what its file's name says unless given.

    Returns:
        The files written.

    Raises:
        InputError: the file is no policy, or one of ours of another structure; or what is written
            cannot hold it.
    """
    read = read_as(path, structure)
    settings = {"control": structure}
    if to == "authors":
        return [export_authors_json(read, folder, name=Path(path).stem)]
    if to == "onnx":
        return [
            export_onnx(
                read, folder, record=results.record(seed=None, inputs=[path], settings=settings)
            )
        ]
    made, full = results.record(seed=seed, inputs=[path], settings=settings), _full(path)
    if to == "crazyflie":
        return export_crazyflie(read, folder, seed=seed, record=made, full=full)
    return export_c(read, folder, seed=seed, record=made, full=full)


def _full(path: StrPath) -> float:
    """Counts of the firmware that u = 1 stood for in the flights of the drone that a policy was
    trained for; the paper's where not told.
    """
    said = trained_with(path).get("full")
    if isinstance(said, int | float) and not isinstance(said, bool) and 0.0 < said <= MOST_COUNTS:
        return float(said)
    return COUNTS
