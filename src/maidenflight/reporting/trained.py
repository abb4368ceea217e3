"""The policies of a run: their files, and what those of a table command."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from maidenflight import policy_file
from maidenflight.policy_file import PolicyFile, UnknownControl


def read_policies(paths: Sequence[Path]) -> dict[Path, PolicyFile]:
    """Reads policies; one of the authors' is left out where nothing says what it commands.

    Raises:
        InputError: a file is no policy.
    """
    files = {}
    for path in paths:
        with suppress(UnknownControl):
            files[path] = policy_file.read_policy(path)
    return files


def controls(files: Mapping[Path, PolicyFile], names: Iterable[str]) -> dict[str, str]:
    """Finds the control structures of policies by the names that a table has for them.

    A name is that of the file, behind as many of its folders as tell files apart; a name that files
    of different control structures share is left out.

    Args:
        files: policies by their paths.
        names: of the policies in a table.
    """
    kinds: dict[str, set[str]] = {}
    for depth in {name.count("/") + 1 for name in names}:
        for path, file in files.items():
            name = "/".join(path.absolute().with_suffix("").parts[-depth:])
            kinds.setdefault(name, set()).add(file.interface.name)
    return {name: each.pop() for name, each in kinds.items() if len(each) == 1}
