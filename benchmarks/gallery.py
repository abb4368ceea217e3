"""Pictures of docs/gallery.md: what maidenflight writes and shows, of a simulated demo.

    maidenflight demo -o run
    python benchmarks/gallery.py run

needs Chromium and Pillow. Pictures are of the files in the run's folder alone.
"""

import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import click
from rich.console import Console
from rich.text import Text

from maidenflight.errors import require_packages
from maidenflight.reporting import run as runs
from maidenflight.reporting.figures.corner import corner
from maidenflight.reporting.figures.delays import delay_posterior
from maidenflight.reporting.figures.picture import svg
from maidenflight.reporting.figures.training import learning_curves
from maidenflight.reporting.sections.head import NAMES

require_packages("PIL")
from PIL import Image  # noqa: E402

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
_MAIDENFLIGHT = (sys.executable, "-m", "maidenflight")
_COLUMNS = 110
LARGEST = 200_000
"""Of a picture [bytes]."""
_ALONE = """<style>body {padding: 12px !important}</style><script>
addEventListener("load", () => setTimeout(() =>
  document.body.replaceChildren(document.querySelector("figure.view")), 1500));
</script>"""


def _browse(page: str, home: Path, size: str, *options: str, query: str = "theme=light") -> None:
    """Opens a page, whose downloads go to a folder, and leaves."""
    browser = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if browser is None:
        raise click.ClickException("needs Chromium.")
    path = home / "page.html"
    path.write_text(page)
    subprocess.run(
        [
            *(browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"),
            *("--virtual-time-budget=8000", f"--window-size={size}", *options),
            f"{path.as_uri()}?{query}",
        ],
        check=True,
        capture_output=True,
        env=os.environ | {"HOME": str(home)},
    )


def _small(picture: Path, to: Path, width: int) -> None:
    """Writes a picture with few colours, at most so wide [px]."""
    image = Image.open(picture).convert("RGB")
    if image.width > width:
        image = image.resize((width, round(image.height * width / image.width)))
    buffer = io.BytesIO()
    image.quantize(64, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        buffer, "png", optimize=True
    )
    to.write_bytes(buffer.getvalue())


def _of_report(run: Path, to: Path) -> None:
    page = (run / "report.html").read_text()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        shot = f"--screenshot={home / 'shot.png'}"
        _browse(page, home, "1120,1590", shot)
        _small(home / "shot.png", to / "report.png", 1000)
        _browse(page, home, "500,1590", shot)
        _small(home / "shot.png", to / "phone.png", 500)
        _browse(page + _ALONE, home, "1000,560", shot, query="theme=light&autoplay")
        _small(home / "shot.png", to / "viewer.png", 1000)


def _of_charts(run: Path, to: Path) -> None:
    """Writes charts of the report as files."""
    read = runs.read_run(run)
    assert read.training is not None
    best = {name: read.estimates[name].value for name in NAMES}
    draws = {name: read.posterior[name] for name in NAMES}
    figures = {
        "corner": corner(draws, best),
        "delays": delay_posterior(read.posterior, read.estimates, runs.truth(read)),
        "learning": learning_curves(read.training),
        "flight": read.recorded[0].plot().figure,
    }
    for name, figure in figures.items():
        (to / f"{name}.svg").write_text(svg(figure, 900 if name in ("learning", "flight") else 560))


def _of_terminal(run: Path, to: Path) -> None:
    """Writes what two commands print."""
    for words in (["log", Path(run.name, "recorded")], ["doctor"]):
        done = subprocess.run(
            [*_MAIDENFLIGHT, *words],
            check=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=run.resolve().parent,
            env=os.environ | {"FORCE_COLOR": "1", "COLUMNS": str(_COLUMNS)},
        )
        console = Console(record=True, width=_COLUMNS, file=io.StringIO())
        console.print(Text.from_ansi(done.stdout))
        picture = console.export_svg(title=f"maidenflight {' '.join(map(str, words))}")
        # Fonts would be fetched from elsewhere.
        picture = re.sub(r"@font-face \{.*?\}", "", picture, flags=re.DOTALL)
        (to / f"{words[0]}.svg").write_text(picture)


@click.command(help=__doc__)
@click.argument("run", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option(
    "-o", "output", default="docs/gallery", type=click.Path(path_type=Path), show_default=True
)
def main(run: Path, output: Path) -> None:
    output.mkdir(parents=True, exist_ok=True)
    shutil.copy(run / "identification.svg", output)
    _of_report(run, output)
    _of_charts(run, output)
    _of_terminal(run, output)
    for path in sorted(output.iterdir()):
        size = path.stat().st_size
        click.echo(f"{path}: {size / 1e3:.0f} kB")
        if size > LARGEST:
            raise click.ClickException(f"{path} is larger than {LARGEST / 1e3:.0f} kB.")


if __name__ == "__main__":
    main()
