"""Animation of learning to fly: a policy at three moments of training, from three initial states.

Run with `python examples/moving_picture.py -o docs/learning.svg` (about two minutes on two cores).
The picture is an SVG that moves by itself where a browser shows it, also as an image, in light and
in dark. Every flight is simulated, in a reality that the policy has not seen in training; nothing
but the drawing stops a drone that falls.
"""

import argparse
from collections.abc import Sequence
from functools import partial
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from scipy.spatial.transform import Rotation

import maidenflight as mf
from maidenflight import results
from maidenflight.flying import engine
from maidenflight.flying.rows import Rows
from maidenflight.policy import Policy
from maidenflight.simulator.environment import Environment
from maidenflight.training.train import Progress

SETTINGS = mf.AnalyticGradient(updates=400, evaluations=40)
SHOWN = (10, 100, 400)
"""Updates whose policies are shown."""
DURATION, FRAMES, REST = 6.0, 20, 0.6
"""Of the flights [s], pictures a second of them, and how long the last one stays [s]."""
WIDTH, HEIGHT, HEAD = 290, 350, 84
"""Of a panel, and of the words above it [px]."""
SCALE, AZIMUTH, ELEVATION = 280.0, np.radians(-62.0), np.radians(24.0)
"""Pixels a metre, and where the drones are seen from."""
REACH, TRAIL = 0.07, 0.8
"""From the centre of a drawn drone to its rotors [m], which is more than a Crazyflie's, and how
long its trail is [s]."""
PERIOD = 3.0
"""Of the circle [s]."""
COLOURS = ("blue", "orange", "green")


class Film(NamedTuple):
    """Some flights of a policy: F pictures of D drones."""

    title: str
    told: str
    position: Float[np.ndarray, "D F 3"]
    attitude: Float[np.ndarray, "D F 3"]
    alive: Float[np.ndarray, "D F"]
    """1 until a drone is on the ground, 0 from then on."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Trains, flies, draws and writes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("learning.svg"), help="SVG file")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    seen: list[Progress] = []
    box = mf.simulator.relative_box(mf.crazyflie(), 0.1)
    mf.train(
        mf.simulator.circle(),
        mf.simulator.pwm(),
        box,
        jax.random.split(jax.random.key(given.seed), 1),
        SETTINGS,
        on_progress=seen.append,
    )
    films = [film(progress, given.seed) for progress in seen if progress.update in SHOWN]
    results.write(given.output, picture(films))
    print(f"written {given.output}, {given.output.stat().st_size / 1e3:.0f} kB")


def film(progress: Progress, seed: int) -> Film:
    """Three flights of the best policy so far."""
    policy = jax.tree.map(lambda leaf: leaf[0], progress.best)
    reality = mf.virtual_drone(7)
    task, controller = mf.simulator.circle(), mf.simulator.pwm()
    env = reality.environment(task, controller, spec=policy.spec)
    keys = jax.random.split(jax.random.key(seed + 1), len(COLOURS))
    rows = jax.tree.map(np.asarray, _fly(env, policy, reality.parameters, keys))
    every = round(mf.simulator.pwm().interface.rate / FRAMES)
    # The middle of the circle becomes that of the picture.
    position, attitude = (
        rows.true_position[:, ::every] - np.array([0.25, 0.0, 0.0]),
        rows.true_attitude[:, ::every].copy(),
    )
    fine = np.isfinite(position).all(axis=2) & (position[:, :, 2] > 0.02)
    alive = np.cumprod(fine, axis=1)
    last = np.maximum(alive.sum(axis=1) - 1, 0).astype(int)
    for drone, end in enumerate(last):
        # What has fallen lies flat.
        position[drone, end:], attitude[drone, end:] = (
            position[drone, end],
            attitude[drone, end] * (alive[drone, -1] or [0, 0, 1]),
        )
    lasted = alive[:, -1].sum()
    off = np.linalg.norm(rows.true_position - rows.true_setpoint, axis=2).mean()
    told = (
        f"{lasted} of {len(alive)} in the air, {100 * off:.0f} cm off"
        if lasted
        else f"all down within {(last.max() + 1) / FRAMES:.1f} s"
    )
    practised = (
        f"{progress.steps / 1e6:.1f} million"
        if progress.steps >= 1e6
        else f"{round(progress.steps, -3):,}"
    )
    return Film(f"{practised} steps of practice", told, position, attitude, alive.astype(float))


@partial(jax.jit, static_argnums=0)
def _fly(env: Environment, policy: Policy, drone: mf.Parameters, keys: Array) -> Rows:
    steps = round(DURATION * env.controller.interface.rate)
    starts = PERIOD * jnp.arange(len(COLOURS)) / len(COLOURS)

    def one(key: Array, start: Array) -> Rows:
        return engine.simulate(
            env, lambda observation, number: policy(observation), drone, key, steps, start
        )

    return jax.vmap(one)(keys, starts)


def seen(points: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 2"]:
    """Where points are in a panel [px], seen from far away."""
    across = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0])
    up = np.array(
        [
            -np.sin(ELEVATION) * np.cos(AZIMUTH),
            -np.sin(ELEVATION) * np.sin(AZIMUTH),
            np.cos(ELEVATION),
        ]
    )
    flat = SCALE * np.stack([points @ across, -(points @ up)], axis=-1)
    return flat + np.array([WIDTH / 2, HEIGHT - 58])


def picture(films: Sequence[Film]) -> str:
    """The whole SVG."""
    width, height = WIDTH * len(films) + 32, HEAD + HEIGHT + 8
    colours = resources.files("maidenflight.reporting").joinpath("colours.css").read_text("utf-8")
    panels = [
        f'<g transform="translate({16 + WIDTH * number} {HEAD})" '
        f'clip-path="url(#panel)">{_panel(each)}</g>'
        for number, each in enumerate(films)
    ]
    heads = [_head(16 + WIDTH * (number + 0.5), each) for number, each in enumerate(films)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" role="img"'
        ' aria-label="A policy learns to fly: '
        f'{"; ".join(f"{each.title}, {each.told}" for each in films)}">'
        f"<style>{colours}{_STYLE}</style>"
        f'<clipPath id="panel"><rect y="-26" width="{WIDTH}" height="{HEIGHT + 26}"/></clipPath>'
        f'<rect width="{width}" height="{height}" rx="10" '
        f'class="paper"/>{"".join(heads)}{"".join(panels)}</svg>\n'
    )


_STYLE = """text { font: 15px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
text { text-anchor: middle; fill: var(--soft); }
.title { font-weight: 600; fill: var(--ink); }
.paper { fill: var(--paper); }
path { fill: none; stroke-linecap: round; stroke-linejoin: round; }
.grid { stroke: var(--grid); stroke-width: 1.2; }
.reference { stroke: var(--line); stroke-width: 1.6; stroke-dasharray: 1 5; }
.trail { stroke-width: 2.6; stroke-linecap: butt; stroke-opacity: 0.55; }
.arms { stroke-width: 3.2; }
.rotors { stroke-width: 1.7; }
.shadow { fill: var(--line); fill-opacity: 0.55; }
"""


def _head(middle: float, shown: Film) -> str:
    return (
        f'<text class="title" x="{middle:g}" y="30">{shown.title}</text><text x="{middle:g}" '
        f'y="52">{shown.told}</text>'
    )


def _panel(shown: Film) -> str:
    turn = np.linspace(0, 2 * np.pi, 121)
    circle = np.stack([0.25 * np.cos(turn), 0.25 * np.sin(turn), np.ones_like(turn)], axis=1)
    lines = np.linspace(-0.33, 0.33, 5)
    floor = "".join(
        _path(seen(np.array(ends)))
        for place in lines
        for ends in ([[place, -0.33, 0], [place, 0.33, 0]], [[-0.33, place, 0], [0.33, place, 0]])
    )
    still = f'<path class="grid" d="{floor}"/><path class="reference" d="{_path(seen(circle))}"/>'
    order = np.argsort(shown.alive.sum(axis=1))
    return still + "".join(
        _drone(shown.position[each], shown.attitude[each], shown.alive[each], COLOURS[each])
        for each in order
    )


def _drone(
    position: Float[np.ndarray, "F 3"],
    attitude: Float[np.ndarray, "F 3"],
    alive: Float[np.ndarray, "F"],
    colour: str,
) -> str:
    """A drone with its shadow and its trail; it fades where it lies on the ground."""
    spot, below = seen(position), seen(position * [1, 1, 0])
    fade = _animate("opacity", [f"{0.25 + 0.75 * value:.2f}" for value in alive])
    moves = _animate("cx", _short(below[:, 0])) + _animate("cy", _short(below[:, 1]))
    shadow = f'<ellipse class="shadow" rx="13" ry="4.5">{moves}</ellipse>'
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(spot, axis=0), axis=1))])
    begun = along[np.maximum(np.arange(len(along)) - round(TRAIL * FRAMES), 0)]
    dashes = [
        f"0 {start:.1f} {end - start + 0.1:.1f} 99999"
        for start, end in zip(begun, along, strict=True)
    ]
    trail = (
        f'<path class="trail" style="stroke:var(--{colour})" '
        f'd="{_path(spot)}">{_animate("stroke-dasharray", dashes)}</path>'
    )
    arms, rotors = _shape(position, attitude)
    body = f'<path class="arms" style="stroke:var(--ink)">{_animate("d", arms)}</path>'
    body += f'<path class="rotors" style="stroke:var(--{colour})">{_animate("d", rotors)}</path>'
    return f"<g>{shadow}{trail}<g>{fade}{body}</g></g>"


def _shape(
    position: Float[np.ndarray, "F 3"], attitude: Float[np.ndarray, "F 3"]
) -> tuple[list[str], list[str]]:
    """Paths of the arms and of the rotors' discs, a picture each."""
    turned = Rotation.from_euler("ZYX", attitude[:, ::-1]).as_matrix()
    hubs = REACH / np.sqrt(2) * np.array([[1, -1, 0], [-1, 1, 0], [-1, -1, 0], [1, 1, 0]])
    ends = seen(position[:, None] + hubs @ turned.transpose(0, 2, 1))
    # A disc is seen as an ellipse: the singular values of what its two axes become.
    flat = seen(0.52 * REACH * turned[:, :, :2].transpose(0, 2, 1)) - seen(np.zeros(3))
    axes, sizes, _ = np.linalg.svd(flat.transpose(0, 2, 1))
    angle = np.unwrap(np.degrees(np.arctan2(axes[:, 1, 0], axes[:, 0, 0])), period=180)
    arms = [
        "".join(f"M{_point(one)}L{_point(other)}" for one, other in (frame[:2], frame[2:]))
        for frame in ends
    ]
    rotors = []
    for frame, (long, short), turn in zip(ends, sizes, angle, strict=True):
        way = long * np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))])
        arc = f"a{long:.1f} {max(short, 0.3):.1f} {turn:.0f} 1 0 "
        rotors.append(
            "".join(
                f"M{_point(hub - way)}{arc}{_point(2 * way)}{arc}{_point(-2 * way)}"
                for hub in frame
            )
        )
    return arms, rotors


def _animate(attribute: str, values: Sequence[str]) -> str:
    """A change over time, again and again; the last picture stays for a while."""
    rest = round(REST * FRAMES)
    shown = ";".join([*values, *[values[-1]] * rest])
    return (
        f'<animate attributeName="{attribute}" dur="{(len(values) + rest) / FRAMES:g}s" '
        f'repeatCount="indefinite" values="{shown}"/>'
    )


def _short(values: Float[np.ndarray, "F"]) -> list[str]:
    return [f"{value:.1f}".removesuffix(".0") for value in values]


def _point(place: Float[np.ndarray, "2"]) -> str:
    return " ".join(_short(place))


def _path(points: Float[np.ndarray, "n 2"]) -> str:
    return "M" + "L".join(_point(point) for point in points)


if __name__ == "__main__":
    main()
