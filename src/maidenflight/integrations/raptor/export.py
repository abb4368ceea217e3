"""The files of a policy of RAPTOR's form: a checkpoint, and for PX4 an archive and commands."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from maidenflight import results
from maidenflight.inputs import StrPath
from maidenflight.integrations.raptor import px4
from maidenflight.integrations.raptor.checkpoint import to_raptor
from maidenflight.policy import Policy

NAME = "policy.h5"


def export_raptor(
    policy: Policy,
    directory: StrPath,
    *,
    name: str = "policy",
    seed: int = 0,
    record: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Writes a policy of RAPTOR's form as `policy.h5`, and for PX4; see `to_raptor` and `px4`.

    Args:
        policy: the policy.
        directory: where to write; made if missing.
        name: see `to_raptor`.
        seed: see `to_raptor`.
        record: see `to_raptor`.

    Returns:
        The files written: the checkpoint, the archive for PX4 and commands to compare.

    Raises:
        InputError: see `to_raptor`; or the directory cannot be written.
    """
    files = {
        NAME: to_raptor(policy, name, seed, record),
        px4.NAME: px4.to_archive(policy, name, seed),
        px4.BENCH: px4.commands(policy),
    }
    return [results.write(Path(directory) / path, content) for path, content in files.items()]
