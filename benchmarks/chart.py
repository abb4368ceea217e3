"""A line chart on logarithmic axes as SVG, written without a plotting package."""

from html import escape
from math import ceil, floor, log10

WIDTH, HEIGHT, LEFT, TOP, RIGHT, BOTTOM = 760, 420, 70, 20, 190, 50
COLOURS = ("#2679c7", "#9cc4e8", "#e2583e", "#f3b3a5", "#3a9d5d", "#b0d9bf")


def lines(curves: dict[str, dict[int, float]], across: str, up: str) -> str:
    """Curves by name, each positive values at positive places."""
    places = [place for curve in curves.values() for place in curve]
    values = [value for curve in curves.values() for value in curve.values()]
    low, high = floor(log10(min(values))), ceil(log10(max(values)))
    first, last = log10(min(places)), max(log10(max(places)), log10(min(places)) + 1)

    def x(place: float) -> float:
        return LEFT + (log10(place) - first) / (last - first) * (WIDTH - LEFT - RIGHT)

    def y(value: float) -> float:
        return TOP + (high - log10(value)) / (high - low) * (HEIGHT - TOP - BOTTOM)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        'font-family="sans-serif" font-size="12" fill="#2d3748">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
    ]
    for power in range(low, high + 1):
        level = y(10.0**power)
        parts.append(f'<path d="M{LEFT} {level:.1f}H{WIDTH - RIGHT}" stroke="#d4dbe4"/>')
        parts.append(
            f'<text x="{LEFT - 6}" y="{level + 4:.1f}" '
            f'text-anchor="end">{_short(10.0**power)}</text>'
        )
    for place in sorted(set(places)):
        parts.append(
            f'<text x="{x(place):.1f}" y="{HEIGHT - BOTTOM + 18}" '
            f'text-anchor="middle">{place:,}</text>'
        )
    parts.append(
        f'<text x="{(LEFT + WIDTH - RIGHT) / 2}" y="{HEIGHT - 8}" '
        f'text-anchor="middle">{escape(across)}</text>'
    )
    parts.append(
        f'<text transform="translate(14 {(TOP + HEIGHT - BOTTOM) / 2}) rotate(-90)" '
        f'text-anchor="middle">{escape(up)}</text>'
    )
    for number, (name, curve) in enumerate(curves.items()):
        colour, height = COLOURS[number % len(COLOURS)], TOP + 14 + 20 * number
        points = " ".join(
            f"{x(place):.1f},{y(value):.1f}" for place, value in sorted(curve.items())
        )
        parts.append(
            f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2.5"/>'
        )
        parts.append(
            f'<path d="M{WIDTH - RIGHT + 14} {height - 4}h18" stroke="{colour}" '
            'stroke-width="2.5"/>'
        )
        parts.append(f'<text x="{WIDTH - RIGHT + 38}" y="{height}">{escape(name)}</text>')
    return "\n".join([*parts, "</svg>\n"])


def _short(value: float) -> str:
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= size:
            return f"{value / size:g} {letter}"
    return f"{value:g}"
