"""Whether the manifest of a run folder lists all that verbs wrote there."""

from collections.abc import Sequence
from pathlib import Path

from maidenflight import manifest


def entries(folder: Path) -> dict[tuple[str, str], set[str]]:
    """Kinds of files by verb and output."""
    listed = manifest.read_manifest(folder).entries
    return {(entry.verb, entry.output): set(entry.written) for entry in listed}


def unlisted(folder: Path, but: Sequence[str] = ()) -> set[str]:
    """Files of a folder that its manifest does not list, but its own and those of some names.

    Fails where a file is listed twice or is not there.
    """
    found = manifest.read_manifest(folder)
    listed = [name for entry in found.entries for names in entry.written.values() for name in names]
    assert len(set(listed)) == len(listed)
    assert found.missing == []
    held = {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in (manifest.NAME, *but)
    }
    return held - set(listed)
