"""export, report and view: a policy for the drone, a page of a run, flights to look at."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from maidenflight import run_folder
from maidenflight.cli import options
from maidenflight.deployment import EXPORTERS


@click.command()
@click.argument("policy", type=options.PATH)
@click.option(
    "--to",
    default="c",
    show_default=True,
    type=click.Choice(list(EXPORTERS)),
    help="; ".join(f"{to}: {exporter.help}" for to, exporter in EXPORTERS.items()) + ".",
)
@options.output(
    "Folder; "
    + ", ".join(f"{exporter.folder} for {to}" for to, exporter in EXPORTERS.items())
    + " unless given."
)
@click.option(
    "--control",
    type=click.Choice(options.CONTROLS),
    help="What an authors' policy commands; unless given, what its file's name begins with or its "
    "folder is called. Ours say it"
    " themselves.",
)
@click.option(
    "--propellers",
    type=click.Choice(options.PROPELLERS),
    help="Of the drone, for crazyflie: the firmware compensates the battery by them; 2.1+ unless "
    "given.",
)
@options.seed
@options.as_json
@options.overwrite
def export(
    policy: Path,
    to: str,
    output: Path | None,
    control: str | None,
    propellers: str | None,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Export a POLICY file to C, ONNX or a Crazyflie app.

    The policy is ours or of Gronauer et al., whose JSON can be written too.
    """
    if propellers is not None and "propellers" not in EXPORTERS[to].takes:
        raise click.BadParameter(f"--to {to} does not depend on the propellers; leave it out.")
    output = output or Path(EXPORTERS[to].folder)
    options.must_be_new(output, overwrite)
    from maidenflight import workflow

    written = workflow.export(policy, output, seed, to, control, propellers)
    content = {"files": [str(path) for path in written]}
    home = policy.parent.parent if policy.parent.name == run_folder.POLICIES else policy.parent
    options.emit(
        as_json,
        content,
        lambda: print("written " + ", ".join(map(str, written))),
        ("report", home),
    )


_REPORT = b"<footer>Written by maidenflight "
"""What every report holds."""


_FILES = {
    "logs": "Flight logs of any format that identify reads, a file or a folder; again for more.",
    "drone": "Identified drone (TOML).",
    "truth": "Parameters of the virtual drone that was recorded (TOML).",
    "policies": "Policy or folder of policies.",
    "flights": "Table of test flights; logs flight_*.csv beside it are shown too.",
    "validation": "Table of prediction errors.",
    "prediction": "Table of predicted flights.",
    "study": "Table of a study.",
}
"""Help of the options that name files; see `run_files.FileOptions`."""


def _file_options(command: Callable[..., None]) -> Callable[..., None]:
    for name, text in reversed(_FILES.items()):
        command = click.option(f"--{name}", type=options.PATH, multiple=name == "logs", help=text)(
            command
        )
    return command


@click.command()
@click.argument("run", required=False, type=options.PATH)
@_file_options
@options.output("HTML file; report.html unless given, in the folder where RUN is one.")
@options.as_json
@click.option(
    "--overwrite",
    is_flag=True,
    help="Replace a file that is no report; an earlier report is replaced anyway.",
)
def report(
    run: Path | None, output: Path | None, as_json: bool, overwrite: bool, **files: Any
) -> None:
    """Make one self-contained HTML page of a RUN.

    RUN is a folder with run.json, which commands write beside their output, or a file or folder
    that it lists; this folder unless given. Files that are renamed, moved or by others are given
    by options, with or without a RUN.
    """
    given = {name: value for name, value in files.items() if value}
    source = run if run is not None or given else Path()
    home = source if source is not None and source.is_dir() else Path()
    output = output or home / run_folder.REPORT
    with suppress(OSError):
        overwrite = overwrite or (output.is_file() and _REPORT in output.read_bytes())
    options.must_be_new(output, overwrite)
    from maidenflight.reporting.page import report as make

    page = make(source, output, **given)
    said = f"written {page}; open it in a browser"
    options.emit(as_json, {"report": str(page)}, lambda: print(said))


@click.command()
@click.argument("flights", type=options.PATH)
@options.output("An .rrd file for rerun; its viewer is started unless given.")
@options.as_json
@options.overwrite
def view(flights: Path, output: Path | None, as_json: bool, overwrite: bool) -> None:
    """View FLIGHTS in rerun: a log, a folder of logs, or a run and what its run.json lists.

    Needs the extra viewer: pip install '.[viewer]' in the source folder.
    """
    if output is not None:
        options.must_be_new(output, overwrite)
    from maidenflight import workflow
    from maidenflight.reporting import live

    shown = workflow.flights_to_view(flights)
    live.show_flights(shown, output)
    content = {"flights": len(shown), "file": str(output) if output else None}
    options.emit(
        as_json,
        content,
        lambda: print(
            f"{len(shown)} flights {f'written to {output}' if output else 'sent to the viewer'}"
        ),
    )
