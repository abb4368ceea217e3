"""The documentation's site: its search works in pages that are opened from disk."""

import hashlib
import re
import shutil
import subprocess
import sys
from os import environ
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)


def test_the_library_of_the_search_is_that_of_its_package() -> None:
    head, code = (ROOT / "docs" / "iframe-worker.js").read_text().split("*/\n")
    assert "iframe-worker 1.0.4" in head
    assert "Permission is hereby granted" in head
    digest = hashlib.sha256(code.strip().encode()).hexdigest()
    assert digest == "97ddb33eee910575c52502ee4d3a1b6960d8d7af47f670b9830ee5e43b6fb7bc"


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_the_search_finds_in_a_page_from_disk(tmp_path: Path) -> None:
    """A site of two pages with the plugins and the theme of ours, but the API's."""
    pytest.importorskip("material")
    settings = (ROOT / "mkdocs.yml").read_text()
    settings = re.sub(r"^hooks:.*$", "", settings, flags=re.MULTILINE)
    settings = re.sub(r"^nav:.*", "", settings, flags=re.MULTILINE | re.DOTALL)
    settings = re.sub(r"^  - (autorefs|mkdocstrings:(\n   .*)+)$", "", settings, flags=re.MULTILINE)
    assert "- offline" in settings
    (tmp_path / "mkdocs.yml").write_text(settings)
    docs = tmp_path / "docs"
    (docs / "guides").mkdir(parents=True)
    (docs / "index.md").write_text("# Home\n\nNothing.\n")
    (docs / "guides" / "lag.md").write_text("# Lag\n\nThe rotors spin up slowly.\n")
    for name in ("iframe-worker.js", "site.css"):
        shutil.copy(ROOT / "docs" / name, docs)
    subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "-q", "-f", str(tmp_path / "mkdocs.yml")],
        check=True,
        env={**environ, "NO_MKDOCS_2_WARNING": "1"},
    )
    for page in ("index.html", "guides/lag.html"):
        shown = subprocess.run(
            [
                *(str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"),
                *("--virtual-time-budget=20000", f"{(tmp_path / 'site' / page).as_uri()}?q=rotors"),
            ],
            check=True,
            capture_output=True,
            text=True,
            env={**environ, "HOME": str(tmp_path)},
        )
        found = re.findall(r'href="([^"?]*)[^"]*" class="md-search-result__link"', shown.stdout)
        assert {Path(each).name for each in found} == {"lag.html"}
