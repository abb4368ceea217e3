"""Known vulnerabilities of the locked versions, and the licences of what each extra installs.

    python benchmarks/audit.py                          # asks PyPI by pip-audit
    python benchmarks/audit.py --licences paper/notes/licences.md

Licences are read of packages that are installed; `--also` names folders with further ones. A table
lists every package that an extra brings, by licence.
"""

import json
import re
import subprocess
import sys
from collections.abc import Iterable, Sequence
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any

import click
from packaging.requirements import Requirement
from page import write

ROOT = Path(__file__).parents[1]
OWN = "maidenflight"
WORDS = {
    "Apache-2.0": r"apache",
    "LGPL": r"lgpl|lesser general",
    "GPL": r"gpl|general public",
    "MPL-2.0": r"mpl|mozilla",
    "BSD": r"bsd",
    "MIT": r"\bmit\b|mit license|expat",
    "PSF": r"python software|psf",
    "ISC": r"\bisc\b",
    "Unlicense": r"unlicense",
    "HPND": r"hpnd|historical permission|cmu",
    "proprietary": r"nvidia|proprietary",
}
"""How licences are called, and words of what packages say of them; the first that fits counts."""
COPYLEFT = ("GPL", "LGPL")


def audit(lock: Path) -> tuple[list[str], list[str], list[str]]:
    """Returns packages that were audited, what is known of some, and those that could not be.

    Raises:
        click.ClickException: pip-audit cannot be had, as without a network.
    """
    command = ["uv", "tool", "run", "pip-audit", "--requirement", str(lock), "--no-deps"]
    command += ["--disable-pip", "--progress-spinner", "off", "--format", "json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    begin = done.stdout.find("{")
    if begin < 0:
        reason = done.stderr.strip().splitlines()
        raise click.ClickException(
            f"no audit: {reason[-1] if reason else 'pip-audit said nothing'}"
        )
    asked, known, unasked = [], [], []
    for one in json.loads(done.stdout[begin:])["dependencies"]:
        if "skip_reason" in one:
            unasked.append(one["name"])
            continue
        asked.append(one["name"])
        known += [
            f"{one['name']} {one['version']}: {flaw['id']}, mended in {flaw['fix_versions']}"
            for flaw in one["vulns"]
        ]
    return asked, known, unasked


def licence_of(package: Distribution) -> str:
    """Returns the licence that a package states, by its usual name."""
    about: Any = package.metadata
    classifiers = [
        text.rpartition("::")[2]
        for text in about.get_all("Classifier") or []
        if text.startswith("License ::")
    ]
    for stated in (about.get("License-Expression"), " ".join(classifiers), about.get("License")):
        names = [name for name, words in WORDS.items() if re.search(words, (stated or "").lower())]
        if "LGPL" in names and "GPL" in names:
            names.remove("GPL")
        if names:
            return " and ".join(names[:2])
    return "not stated"


def closure(extra: str, known: dict[str, Distribution]) -> tuple[set[str], set[str]]:
    """Returns the packages that an extra brings, and those of them that are not installed."""
    found: set[str] = set()
    absent: set[str] = set()
    queue = [(OWN, extra)]
    while queue:
        name, wanted = queue.pop()
        for text in known[name].requires or []:
            requirement = Requirement(text)
            if requirement.marker and not requirement.marker.evaluate({"extra": wanted}):
                continue
            # What an extra asks for with a marker of its own belongs to that extra alone.
            if name == OWN and wanted and "extra" not in text:
                continue
            other = _plain(requirement.name)
            if other in found or other in absent:
                continue
            (found if other in known else absent).add(other)
            queue += [(other, each) for each in ("", *requirement.extras) if other in known]
    return found, absent


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def tabulate(also: Sequence[str]) -> str:
    """Returns a table of what each extra brings, by licence."""
    known = {_plain(one.metadata["Name"]): one for one in distributions(path=[*also, *sys.path])}
    extras = sorted(set(known[OWN].metadata.get_all("Provides-Extra") or []) - {"dev"})
    lines = ["| extra | packages by licence | GPL |", "|---|---|---|"]
    base, _ = closure("", known)
    for extra in ("", *extras):
        names, absent = closure(extra, known)
        own = names if not extra else names - base
        by: dict[str, list[str]] = {}
        for name in sorted(own):
            by.setdefault(licence_of(known[name]), []).append(name)
        cells = [f"{licence}: {', '.join(ones)}" for licence, ones in sorted(by.items())]
        if absent - base:
            cells.append(f"not looked at: {', '.join(sorted(absent - base))}")
        strict = _copyleft(by)
        lines.append(f"| {f'`{extra}`' if extra else '(always)'} | {'; '.join(cells)} | {strict} |")
    return "\n".join(lines)


def _copyleft(by: dict[str, list[str]]) -> str:
    ones: Iterable[str] = (
        f"{', '.join(names)} ({licence})"
        for licence, names in by.items()
        if any(word in COPYLEFT for word in licence.split(" and "))
    )
    return "; ".join(ones) or "none"


@click.command()
@click.option("--lock", type=click.Path(path_type=Path), default=ROOT / "requirements.lock")
@click.option("--licences", type=click.Path(path_type=Path, exists=True), help="Page to write.")
@click.option("--also", multiple=True, help="Folder with further packages, for their licences.")
def main(lock: Path, licences: Path | None, also: Sequence[str]) -> None:
    """Audits, or writes the table of licences."""
    if licences is not None:
        write(licences, {"licences": tabulate(also)})
        return
    asked, known, unasked = audit(lock)
    print(f"{len(asked)} packages asked for, {len(known)} known vulnerabilities")
    print("\n".join(known))
    if unasked:
        print(
            f"not asked for, as PyPI does not know these versions or cannot be reached "
            f"({len(unasked)}): {', '.join(unasked)}"
        )
    if known:
        sys.exit(1)


if __name__ == "__main__":
    main()
