"""What the page shows of a step: sections of the report, drawn by the report's scripts.

Importing what draws them takes seconds, so that it is imported at their first use.
"""

import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from maidenflight.errors import InputError
from maidenflight.integrations.app import steps
from maidenflight.integrations.app.jobs import Job
from maidenflight.manifest import Manifest
from maidenflight.reporting import html

if TYPE_CHECKING:
    from maidenflight.reporting.run import Run

SECTIONS = {
    **{"log": "recorded", "identify": "parameters", "validate": "validation", "train": "training"},
    **{"transfer": "flights", "predict": "predicted", "sweep": "study"},
}
"""Sections of the report by the verb whose results they show."""
PREVIEW = "preview"  # the flight of a policy in training
_OWN = "maidenflight.integrations.app"
_one_at_a_time = threading.Lock()


def render(template: str, **content: Any) -> str:
    """Fills a template of this package; what is not `Markup` is escaped."""
    return html.sendable(html.render(template, _OWN, **content))


def _vega() -> list[Markup]:
    from maidenflight.reporting import page

    return [*page.vega(), Markup(f"const LOOK = {html.asset('look.json')};")]


_ASSETS: dict[str, Callable[[], list[Markup]]] = {
    "page.css": lambda: [html.style(), html.asset("static/app.css", _OWN)],
    "page.js": lambda: [html.asset("page.js")],
    "app.js": lambda: [html.asset("static/app.js", _OWN)],
    "view.js": lambda: [html.asset("charts.js"), html.asset("static/view.js", _OWN)],
    "viewer.js": lambda: [html.asset(name) for name in ("scene.js", "traces.js", "viewer.js")],
    "vega.js": _vega,
}


@cache
def asset(name: str) -> str:
    """Returns a script or style sheet of the page; InputError where there is none so named."""
    if name not in _ASSETS:
        raise InputError(f"{name}: no part of the page.")
    return "\n".join(_ASSETS[name]())


def view(run: Manifest, name: str, job: Job | None, flights: Path) -> str:
    """Returns the page of a verb's results, or of `flights` of a policy in training.

    Of a training that runs, its scores so far. InputError where nothing is there, or is broken.
    """
    import polars

    from maidenflight.reporting import page
    from maidenflight.reporting.run import Run, read_run

    entries = steps.read_step(run, name).entries
    with _one_at_a_time:
        if job is not None and job.scores and job.state != "done":
            return _draw(name, Run(training=polars.DataFrame(job.scores)))
        if name == "report":
            return page.to_html(read_run(run.folder))
        if name == "log":
            return _draw(name, read_run(None, {"logs": run.folder / steps.find_logs(run)}))
        if name == PREVIEW:
            return _draw("transfer", read_run(flights))
        if not entries or name not in SECTIONS:
            raise InputError(f"{name}: nothing to show yet.")
        return _draw(name, read_run(run.folder / entries[-1].output))


def _draw(name: str, run: "Run") -> str:
    from maidenflight.reporting import page, viewer
    from maidenflight.reporting.figures.charts import embedded

    section = SECTIONS[name]
    content = Markup().join(make(run) for key, _, make in page.SECTIONS if key == section)
    logs = viewer.viewer_data(run) if section in ("recorded", "flights") else None
    return render("view.html", content=content, logs=embedded(logs) if logs else "")
