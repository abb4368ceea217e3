"""A policy for other programs."""

from pathlib import Path

from maidenflight import results
from maidenflight.deployment import EXPORTERS
from maidenflight.inputs import StrPath
from maidenflight.workflow.policies import hover_of, read_as


def export(
    path: StrPath, folder: StrPath, seed: int, to: str = "c", structure: str | None = None
) -> list[Path]:
    """Writes a policy, ours or the authors', for other programs.

    Args:
        path: policy file.
        folder: where to write; made if missing.
        seed: of random numbers in what is written, such as observations of a self-test.
        to: a name in `deployment.EXPORTERS`.
        structure: what an authors' policy commands; what its file's name says unless given.

    Returns:
        The files written.

    Raises:
        InputError: the file is no policy, or one of ours of another structure; or what is written
            cannot hold it.
    """
    exporter = EXPORTERS[to]
    policy = read_as(path, structure)
    record = results.record(
        seed=seed if "seed" in exporter.takes else None,
        inputs=[path],
        settings={"to": to, "control": policy.interface.name},
    )
    given = {"name": Path(path).stem, "hover": hover_of(path), "seed": seed, "record": record}
    return exporter(policy, folder, **given)
