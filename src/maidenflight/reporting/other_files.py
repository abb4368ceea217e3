"""Other files of a run folder, which its page does not show but names."""

from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path

from maidenflight import inputs, run_folder

_KINDS = {
    run_folder.FLIGHTS.name: "test flights",
    f"{run_folder.POLICY.stem}_*{run_folder.POLICY.suffix}": "policies",
    f"{run_folder.LOG.stem}_*{run_folder.LOG.suffix}": "flight logs",
}
"""What a folder holds, by the names of the files in it."""
MOST = 20
"""Names of a kind that the page lists."""


def find(folder: Path, shown: Collection[Path]) -> dict[str, list[str]]:
    """Names of folders and files of a run that a page does not show, by what they hold.

    Args:
        folder: of the run.
        shown: folders that the page shows.
    """
    found: dict[str, list[str]] = {}
    for kind, name in (*_folders(folder, shown), *_files(folder)):
        found.setdefault(kind, []).append(name)
    return found


def _folders(folder: Path, shown: Collection[Path]) -> Iterator[tuple[str, str]]:
    for place in sorted(folder.iterdir()):
        if place.is_dir() and place not in shown:
            held = next(
                (
                    kind
                    for names, kind in _KINDS.items()
                    if next(place.glob(names), None) is not None
                ),
                "",
            )
            if held:
                yield held, f"{place.name}/"


def _files(folder: Path) -> Iterator[tuple[str, str]]:
    for own, kind in (
        (run_folder.PREDICTION.name, "predicted flights"),
        (run_folder.VALIDATION.name, "prediction errors"),
    ):
        for path in sorted(folder.glob(f"{own.removesuffix('.csv')}*.csv")):
            if path.name not in (own, run_folder.WINDOWS.name) and _begins(
                path, f"# maidenflight {own.removesuffix('.csv')} "
            ):
                yield kind, path.name
    for path in sorted(folder.glob("*.toml")):
        if path.name != run_folder.DRONE and _identified(path):
            yield "identified drones", path.name


def _begins(path: Path, words: str) -> bool:
    with suppress(OSError, UnicodeDecodeError):
        return any(line.startswith(words) for line in inputs.comments(path))
    return False


def _identified(path: Path) -> bool:
    with suppress(OSError, UnicodeDecodeError):
        return "\n[identification]" in inputs.text(path)
    return False
