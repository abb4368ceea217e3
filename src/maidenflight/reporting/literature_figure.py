"""The picture of identified parameters beside what others give for a Crazyflie."""

from collections.abc import Mapping

import numpy as np

from maidenflight.errors import InputError
from maidenflight.reporting import literature, svg
from maidenflight.reporting.delay_figures import Estimated
from maidenflight.reporting.svg import Panel

ROW = 30.0
"""Height of a parameter [px]."""


def comparable(name: str) -> bool:
    """Whether the paper has a value above zero, of which a parameter can be shown as a multiple."""
    return literature.of_the_paper(name) > 0


def beside_literature(
    estimates: Mapping[str, Estimated],
    truth: Mapping[str, tuple[float, float]] | None = None,
    width: float = 720,
) -> str:
    """Identified parameters, each as a multiple of the paper's value, on one logarithmic axis.

    Args:
        estimates: by parameter; those that the paper's model lacks are left out.
        truth: from and to, by parameter, of a virtual drone [SI].
        width: of the picture [px].

    Raises:
        InputError: none of the parameters has a value above zero in the paper.
    """
    shown = [name for name in estimates if comparable(name) and estimates[name].value > 0]
    if not shown:
        raise InputError(
            "no parameter to draw beside the literature: the paper gives none of them a value "
            "above zero."
        )
    paper = {name: literature.of_the_paper(name) for name in shown}
    others = {name: literature.published(name) for name in shown}
    values = [each.value / paper[name] for name in shown for each in others[name]]
    values += [
        side / paper[name]
        for name in shown
        for side in (*estimates[name].interval, *(truth or {}).get(name, ()))
        if side > 0
    ]
    ends = np.log2([min([*values, 0.9]), max([*values, 1.1])])
    legend, tall = svg.legend(svg.TITLE, width, _legend(bool(truth)))
    left = 92.0
    panel = Panel(
        left,
        svg.TITLE + tall + 8,
        width - left - 10,
        ROW * len(shown) + 8,
        svg.margin(ends),
        (0.0, 1.0),
    )
    parts = [legend, *_axis(panel)]
    content = [_grid(panel)]
    for number, name in enumerate(shown):
        down = 4 + (number + 0.5) * ROW
        parts.append(svg.text(left - 10, panel.top + down + 4.5, svg.symbol(name), "strong", "end"))
        content.append(
            _others(panel, [(each.value / paper[name], each.source) for each in others[name]], down)
        )
        if truth and name in truth:
            low, high = (
                float(panel.across(np.log2(max(side, 1e-12) / paper[name]))) for side in truth[name]
            )
            content.append(
                svg.stroke(
                    f"M{low:.1f} {down - 9:.1f}v18M{high:.1f} {down - 9:.1f}v18M{low:.1f} "
                    f"{down:.1f}H{high:.1f}",
                    "line",
                    "green",
                )
            )
        content.append(_estimate(panel, estimates[name], paper[name], down))
    parts.append(svg.framed(panel, content, "literature"))
    return svg.picture(width, panel.top + panel.height + 44, "Beside the literature", parts)


def _legend(truth: bool) -> list[tuple[str, str]]:
    entries = [(svg.stroke("M12 2V10M4 6H20", "heavy", "orange"), "identified, 95 % interval")]
    entries += [(svg.stroke("M4 0V12M20 0V12M4 6H20", "line", "green"), "truth")] if truth else []
    return [
        *entries,
        (svg.stroke("M12 0V12", "line", "purple"), "paper"),
        (svg.stroke("M12 6h0", "spots", "soft"), "others"),
    ]


_STEPS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8, 16)


def _axis(panel: Panel) -> list[str]:
    names = {
        step: f"{step:g}" if step >= 1 else f"1/{1 / step:g}"
        for step in _STEPS
        if panel.x[0] <= np.log2(step) <= panel.x[1]
    }
    foot = panel.top + panel.height
    marks = [
        svg.text(
            panel.left + float(panel.across(np.log2(step))),
            foot + 17,
            f"{name}\N{MULTIPLICATION SIGN}",
            "",
            "middle",
        )
        for step, name in names.items()
    ]
    return [
        *marks,
        svg.text(
            panel.left + panel.width / 2, foot + 36, "multiple of the paper's value", "", "middle"
        ),
    ]


def _grid(panel: Panel) -> str:
    lines = "".join(
        f"M{float(panel.across(np.log2(step))):.1f} 0V{panel.height:.1f}"
        for step in _STEPS
        if step != 1
    )
    one = float(panel.across(0.0))
    return f'<path class="grid" d="{lines}"/>' + svg.stroke(
        f"M{one:.1f} 0V{panel.height:.1f}", "line", "purple"
    )


def _others(panel: Panel, values: list[tuple[float, str]], down: float) -> str:
    places = [
        (float(panel.across(np.log2(ratio))), svg.titled("", source)) for ratio, source in values
    ]
    return "".join(
        f"<g>{svg.stroke(f'M{place:.1f} {down:.1f}h0', 'spots', 'soft')}{tip}</g>"
        for place, tip in places
    )


def _estimate(panel: Panel, found: Estimated, paper: float, down: float) -> str:
    low, middle, high = (
        float(panel.across(np.log2(max(side, 1e-12) / paper)))
        for side in (found.interval[0], found.value, found.interval[1])
    )
    path = f"M{low:.1f} {down:.1f}H{high:.1f}M{middle:.1f} {down - 7:.1f}v14"
    return svg.stroke(path, "rim", "paper") + svg.stroke(path, "heavy", "orange")
