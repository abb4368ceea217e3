"""Policies of a study that lie in its folder already: nothing is trained twice."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from maidenflight import policy_file, run_folder
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.policy import Policy
from maidenflight.settings import plain


def kept_policies(
    folder: StrPath,
    count: int,
    record: Mapping[str, Any],
    learn: Callable[[], Iterable[Policy]],
    restart: bool = False,
) -> list[Policy]:
    """Reads the policies of a folder, or makes and writes them: nothing is trained twice.

    Args:
        folder: of `policy_1.json`, `policy_2.json`, ...
        count: how many.
        record: of their making.
        learn: makes them; called where one of the files is missing.
        restart: use nothing of what is there.

    Raises:
        InputError: the folder holds policies with another record.
    """
    files = [run_folder.POLICY.path(folder, number) for number in range(1, count + 1)]
    if restart or not all(path.exists() for path in files):
        for path in files if restart else []:
            path.unlink(missing_ok=True)
        for path, one in zip(files, learn(), strict=True):
            policy_file.write_policy(path, one, record)
    policies = [policy_file.read_policy(path) for path in files]
    for path, one in zip(files, policies, strict=True):
        if one.record != plain(record):
            raise InputError(
                f"{path}: from a run with other settings or of another version. Choose another "
                "folder with -o."
            )
    return [one.policy for one in policies]
