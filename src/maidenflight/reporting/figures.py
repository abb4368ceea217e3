"""Plotly figures of a run, as plain dictionaries.

Colours are the names of CSS variables, `var(--blue)`; the page's script puts in what they mean in light, in dark and in print.
"""

import html
from collections.abc import Mapping
from typing import Any

import numpy as np
import polars

from maidenflight.parameters import crazyflie
from maidenflight.reporting.run import Run

Figure = dict[str, Any]

FEW = 12
"""Up to this many rows of flight times are shown one by one."""
CLIP = 10.0
"""Objectives further than this above the best share one colour [%]."""
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


def valley(run: Run) -> Figure | None:
    """All evaluations of the objective over T_m and latency, coloured by how far they are above the best."""
    names = ("motor_time_constant", "latency")
    if run.search is None or not set(names) <= set(run.search.columns):
        return None
    rows = run.search.filter(polars.col("objective").is_finite()).sort("objective", descending=True)
    if rows.height == 0:
        return None
    lag, delay = (rows[name].to_numpy() * 1000 for name in names)
    above = (rows["objective"].to_numpy() / rows["objective"].min() - 1) * 100
    best = tuple(run.estimates[name].value * 1000 for name in names) if set(names) <= set(run.estimates) else (lag[-1], delay[-1])
    truth = _truth(run)
    paper = crazyflie()
    known = (float(paper.motor_time_constant) * 1000, float(paper.latency) * 1000)
    marked = [best, known, *((corner[0], corner[1]) for corner in truth)]
    near = above < CLIP
    x = _range([*lag[near], *(mark[0] for mark in marked)])
    y = _range([*delay[near], *(mark[1] for mark in marked)])
    total = sum(best)
    traces = [
        {
            "name": "evaluation",
            "mode": "markers",
            "showlegend": False,
            "x": _rounded(lag, 2),
            "y": _rounded(delay, 2),
            "customdata": _rounded(above, 2),
            "marker": {
                "size": 7,
                "color": _rounded(np.minimum(above, CLIP), 2),
                "cmin": 0,
                "cmax": CLIP,
                "colorscale": [[0, "var(--low)"], [0.5, "var(--middle)"], [1, "var(--high)"]],
                "line": {"width": 0.5, "color": "var(--line)"},
                "colorbar": {
                    "title": {"text": "objective above the best [%]", "side": "right", "font": {"size": 13}},
                    "thickness": 10,
                    "outlinewidth": 0,
                    "tickvals": [0, 2.5, 5, 7.5, 10],
                    "ticktext": ["0", "2.5", "5", "7.5", "≥ 10"],
                },
            },
            "hovertemplate": "T<sub>m</sub> %{x:.1f} ms, Δ %{y:.1f} ms<br>%{customdata:.1f} % above the best<extra></extra>",
        },
        {
            "name": f"T<sub>m</sub> + Δ = {total:.1f} ms",
            "mode": "lines",
            "x": [round(total - side, 3) for side in y],
            "y": [round(side, 3) for side in y],
            "line": {"color": "var(--soft)", "width": 1.5, "dash": "dash"},
            "hoverinfo": "skip",
            "showlegend": True,
        },
    ]
    if truth:
        traces.append(_box(truth))
    traces.append(_mark("the paper's drone", known, "diamond-open", "var(--purple)"))
    traces.append(_mark("identified", best, "cross-thin", "var(--orange)"))
    legend = {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "bgcolor": "rgba(0,0,0,0)"}
    axes = _axis("motor time constant T<sub>m</sub> [ms]", range=x), _axis("latency Δ [ms]", range=y)
    return _figure(traces, *axes, 440, showlegend=True, legend=legend, margin={"l": 48, "r": 8, "t": 40, "b": 44})


def _range(values: list[Any]) -> list[float]:
    low, high = min(values), max(values)
    margin = 0.06 * (high - low) or 1.0
    return [round(float(low - margin), 3), round(float(high + margin), 3)]


def _truth(run: Run) -> tuple[tuple[float, float], ...]:
    """Corners of what the truth spans: T_m speeding up to slowing down, latency of commands to that with the sensors' [ms]."""
    if run.reality is None:
        return ()
    lag, delay = float(run.reality.motor_time_constant) * 1000, float(run.reality.latency) * 1000
    slow, late = lag * float(run.reality.motor_slowdown), delay + float(run.reality.estimator_delay + run.reality.gyro_lag) * 1000
    return ((lag, delay), (slow, delay), (slow, late), (lag, late))


def _box(corners: tuple[tuple[float, float], ...]) -> Figure:
    closed = [*corners, corners[0]]
    return {
        "name": "truth",
        "mode": "lines+markers",
        "x": [round(corner[0], 3) for corner in closed],
        "y": [round(corner[1], 3) for corner in closed],
        "line": {"color": "var(--green)", "width": 2},
        "marker": {"size": 4, "color": "var(--green)"},
        "hovertemplate": "truth: T<sub>m</sub> %{x:.1f} ms, Δ %{y:.1f} ms<extra></extra>",
    }


def _mark(name: str, place: tuple[float, ...], shape: str, colour: str) -> Figure:
    return {
        "name": name,
        "mode": "markers",
        "x": [round(float(place[0]), 3)],
        "y": [round(float(place[1]), 3)],
        "marker": {"symbol": shape, "size": 13, "color": colour, "line": {"width": 3 if "thin" in shape else 2, "color": colour}},
        "hovertemplate": f"{name}: T<sub>m</sub> %{{x:.1f}} ms, Δ %{{y:.1f}} ms<extra></extra>",
    }


def learning(run: Run) -> dict[str, Figure]:
    """Learning curves: a thin line a policy, a thick one for their mean."""
    if run.training is None:
        return {}
    scores: Mapping[str, tuple[str, float]] = {
        "episode_return": ("episode return", 1.0),
        "survival": ("episodes survived [%]", 100.0),
        "position_error": ("position error [cm]", 100.0),
    }
    mean = run.training.group_by("steps").mean().sort("steps")
    figures = {}
    for column, (title, scale) in scores.items():
        parts = [(f"policy {policy[0]:g}", rows) for policy, rows in run.training.group_by("policy", maintain_order=True)]
        traces = [
            {
                "name": name,
                "mode": "lines",
                "x": _rounded(rows["steps"] / 1e6, 3),
                "y": _rounded(rows[column] * scale, 3),
                "line": {"color": "var(--blue)", "width": 3 if name == "mean" else 1},
                "opacity": 1.0 if name == "mean" else 0.55,
                "hovertemplate": f"{name}: %{{y:.4~g}} at %{{x:.3~g}} M steps<extra></extra>",
            }
            for name, rows in [*parts, ("mean", mean)]
        ]
        figures[column] = _figure(traces, _axis("simulated steps [million]", rangemode="tozero"), _axis(title), 260)
    return figures


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
