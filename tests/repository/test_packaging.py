"""The ways to install that are not make: an image and a conda environment, and the completion of
commands in a shell."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]


def engine() -> str | None:
    """A container engine that runs."""
    for name in ("docker", "podman"):
        if (
            shutil.which(name)
            and not subprocess.run([name, "info"], capture_output=True).returncode
        ):
            return name
    return None


def copied() -> list[str]:
    """What the Dockerfile copies, relative to the checkout."""
    lines = re.findall(r"^COPY (.*) \S+$", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    return [name for line in lines for name in line.split()]


def test_the_image_is_made_of_what_an_install_needs() -> None:
    locks = {"requirements.lock", "requirements.hashes"}
    needed = {"pyproject.toml", *locks, "README.md", "LICENSE", "src"}
    assert set(copied()) == needed
    assert all((ROOT / name).exists() for name in needed)


def test_both_locks_name_the_same_versions_and_every_package_has_a_hash() -> None:
    named, hashed = (
        re.findall(r"^[\w.-]+==\S+(?: ;[^\n\\]*)?", (ROOT / name).read_text(), re.MULTILINE)
        for name in ("requirements.lock", "requirements.hashes")
    )
    assert [line.strip() for line in named] == [line.strip() for line in hashed]
    packages = re.split(r"^(?=\w)", (ROOT / "requirements.hashes").read_text(), flags=re.MULTILINE)
    assert all(re.search(r"--hash=sha256:[0-9a-f]{64}", one) for one in packages if one.strip())


@pytest.mark.slow
def test_the_image_builds_and_tells_its_version() -> None:
    name = engine()
    if name is None:
        pytest.skip("needs docker or podman, running")
    subprocess.run([name, "build", "-q", "-t", "maidenflight-test", str(ROOT)], check=True)
    ran = subprocess.run(
        [name, "run", "--rm", "--user", "1000", "maidenflight-test", "--version"],
        check=True,
        capture_output=True,
        text=True,
    )
    assert re.fullmatch(r"maidenflight, version \d+\.\d+\.\d+\n", ran.stdout)


def test_the_conda_environment_installs_the_checkout_from_the_lock() -> None:
    told = yaml.safe_load((ROOT / "environment.yml").read_text())
    (python,) = [one for one in told["dependencies"] if str(one).startswith("python=")]
    version = tuple(map(int, python.removeprefix("python=").split(".")))
    assert (3, 11) <= version < (3, 14)
    (by_pip,) = [one["pip"] for one in told["dependencies"] if isinstance(one, dict)]
    assert [shlex.split(line) for line in by_pip] == [
        ["--constraint", "requirements.lock"],
        ["--editable", "."],
    ]


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        (["maidenflight", "tr"], ["train", "transfer"]),
        (["maidenflight", "train", "--control", "att"], ["attitude_rate", "attitude"]),
        (["maidenflight", "identify", "--over"], ["--overwrite", "--over"]),
    ],
)
def test_a_shell_completes_by_the_line_of_the_docs(
    typed: list[str], expected: list[str], tmp_path: Path
) -> None:
    page = (ROOT / "docs" / "quickstart.md").read_text()
    (line,) = re.findall(r"^eval .*maidenflight.*$", page, re.M)
    command = tmp_path / "maidenflight"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m maidenflight "$@"\n')
    command.chmod(0o755)
    words = " ".join(map(shlex.quote, typed))
    script = f"""{line}
COMP_WORDS=({words}) COMP_CWORD={len(typed) - 1}
$(complete -p maidenflight | sed 's/.*-F \\([^ ]*\\).*/\\1/') maidenflight
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    shown = subprocess.run(
        ["bash", "--norc", "-c", script],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"},
    )
    assert sorted(shown.stdout.split()) == sorted(expected)
