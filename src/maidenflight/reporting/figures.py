"""Plotly figures of a run, as plain dictionaries.

Colours are the names of CSS variables, `var(--blue)`; the page's script puts in what they mean in light, in dark and in print.
"""

import html
from typing import Any

import numpy as np
import polars

from maidenflight.reporting.run import Run

Figure = dict[str, Any]

FEW = 12
"""Up to this many rows of flight times are shown one by one."""
_MARKS = {
    "time limit": ("circle", "var(--blue)"),
    "position error": ("x", "var(--orange)"),
    "tilt": ("triangle-up", "var(--purple)"),
    "body rate": ("diamond", "var(--green)"),
    "not finite": ("square", "var(--ink)"),
}
"""Symbol and colour of a flight, by why it ended."""


def _axis(title: str, **more: Any) -> Figure:
    return {
        "title": {"text": title, "standoff": 8, "font": {"size": 13}},
        "gridcolor": "var(--grid)",
        "linecolor": "var(--line)",
        "tickcolor": "var(--line)",
        "zeroline": False,
        "showline": True,
        "automargin": True,
        "fixedrange": True,
        **more,
    }


def _figure(traces: list[Figure], x: Figure, y: Figure, height: int, **more: Any) -> Figure:
    layout = {
        "xaxis": x,
        "yaxis": y,
        "height": height,
        "margin": {"l": 48, "r": 12, "t": 12, "b": 44},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"family": "system-ui, sans-serif", "size": 13, "color": "var(--soft)"},
        "hoverlabel": {
            "bgcolor": "var(--paper)",
            "bordercolor": "var(--line)",
            "font": {"family": "system-ui, sans-serif", "color": "var(--ink)"},
        },
        "hovermode": "closest",
        "dragmode": False,
        "showlegend": False,
        **more,
    }
    return {"data": traces, "layout": layout}


def _rounded(values: Any, decimals: int) -> list[float | None]:
    return [round(float(value), decimals) if np.isfinite(value) else None for value in np.asarray(values, np.float64)]


def durations(run: Run) -> Figure | None:
    """One dot a flight: how long it lasted and why it ended; a row a policy and reality, while these are few."""
    if run.table is None:
        return None
    several = run.table["reality"].n_unique() > 1
    label = polars.format("{} on {}", "policy", "reality") if several else polars.format("{}", "policy")
    rows = run.table.with_columns(label.alias("row"))
    if rows["row"].n_unique() > FEW:
        rows = rows.with_columns(polars.col("reality").alias("row"))
    names = rows["row"].unique(maintain_order=True).to_list()[::-1]
    place = {name: number for number, name in enumerate(names)}
    count, height = {name: rows.filter(polars.col("row") == name).height for name in names}, dict.fromkeys(names, 0)
    spots = []
    for name in rows["row"]:
        height[name] += 1
        spots.append(round(place[name] - 0.32 + 0.64 * (height[name] - 0.5) / count[name], 3))
    rows = rows.with_columns(polars.Series("spot", spots))
    traces = []
    for reason, part in rows.group_by("end_reason", maintain_order=True):
        symbol, colour = _MARKS.get(str(reason[0]), ("star", "var(--ink)"))
        name = "reached the time limit" if reason[0] == "time limit" else f"ended by {html.escape(str(reason[0]))}"
        traces.append(
            {
                "name": name,
                "mode": "markers",
                "x": _rounded(part["duration"], 3),
                "y": part["spot"].to_list(),
                "customdata": part["flight"].to_list(),
                "marker": {"symbol": symbol, "size": 9, "color": colour},
                "cliponaxis": False,
                "hovertemplate": f"flight %{{customdata}}: %{{x:.2f}} s, {name}<extra></extra>",
            }
        )
    longest = float(rows["duration"].to_numpy().max())
    y = _axis(
        "",
        tickvals=list(place.values()),
        ticktext=[html.escape(name) for name in names],
        range=[-0.6, len(names) - 0.4],
        showgrid=True,
        showline=False,
    )
    x = _axis("flight time [s]", range=[0, round(longest * 1.04, 3)])
    legend = {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"}
    return _figure(traces, x, y, 110 + 44 * len(names), showlegend=True, legend=legend, margin={"l": 48, "r": 12, "t": 34, "b": 44})
