"""Pictures of a drone and its reference, drawn with Pillow.

The camera stands still, so floor, grid and reference are drawn once; a frame adds the drone, its
shadow and its trail. Everything is drawn at twice the size and scaled down, which smooths the
edges.
"""

from collections import deque
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw, ImageFont

from maidenflight.parameters import Parameters, arm_length, rotors
from maidenflight.simulator.tasks.tasks import Task

SIZE = (640, 480)
"""Width and height of a picture [pixels]."""
_FINE = 2
_AZIMUTH, _ELEVATION = np.radians(-62.0), np.radians(17.0)
_SKY, _FLOOR, _GRID, _INK = (247, 249, 252), (236, 240, 245), (212, 219, 228), (45, 55, 72)
_PATH, _SETPOINT, _TRAIL, _SHADOW = (120, 144, 176), (226, 88, 62), (38, 121, 199), (206, 213, 223)
_FRONT, _BACK = (226, 88, 62), (38, 121, 199)
_TURN = np.linspace(0.0, 2 * np.pi, 49)[:-1]
_CIRCLE = np.stack([np.cos(_TURN), np.sin(_TURN), np.zeros(48)], axis=1)


class View(NamedTuple):
    """Picture of a drone."""

    position: Float[np.ndarray, "3"]
    """[m]."""
    rotation: Float[np.ndarray, "3 3"]
    """Body to world."""
    rotor_speed: Float[np.ndarray, "4"]
    """[-], in [0, 1]."""
    setpoint: Float[np.ndarray, "3"]
    """[m]."""


class Scene:
    """A task before a camera that stands still."""

    def __init__(self, task: Task, drone: Parameters) -> None:
        """Places the camera so that the whole reference and the floor under it are in view.

        Args:
            task: whose reference is drawn.
            drone: whose rotors are drawn where they are, at a visible size.
        """
        self._hubs = rotors(drone) / arm_length(drone)
        times = jnp.linspace(0.0, task.duration, 240)
        self._path = np.asarray(jax.jit(jax.vmap(task.reference))(times), np.float64)
        low, high = self._path.min(0), self._path.max(0)
        self._centre = np.array([*(low + high)[:2] / 2, max(high[2], 0.6) * 0.54])
        self._reach = max(float(np.max(high - low)) * 0.75, max(high[2], 0.6) * 0.85)
        self._arm = 0.085 * self._reach
        c, s, e, f = np.cos(_AZIMUTH), np.sin(_AZIMUTH), np.cos(_ELEVATION), np.sin(_ELEVATION)
        self._axes = np.array([[-s, c, 0.0], [-f * c, -f * s, e], [e * c, e * s, f]])
        self._font = ImageFont.load_default(size=13 * _FINE)
        self._still = self._background()
        self._trail: deque[np.ndarray] = deque(maxlen=120)

    def begin(self) -> None:
        """Forgets where the drone has been."""
        self._trail.clear()

    def draw(self, view: View) -> np.ndarray:
        """Returns one picture: red, green, blue, (480, 640, 3) uint8."""
        position, rotation, rotor_speed, setpoint = (np.asarray(part, np.float64) for part in view)
        self._trail.append(position)
        picture = self._still.copy()
        pen = ImageDraw.Draw(picture)
        self._draw_trail(pen)
        self._draw_setpoint(pen, setpoint, position)
        self._draw_drone(pen, position, rotation, rotor_speed)
        error = float(np.linalg.norm(position - setpoint))
        pen.text(
            (14 * _FINE, 11 * _FINE),
            f"height {position[2]:.2f} m   error {100 * error:.1f} cm",
            _INK,
            self._font,
        )
        return np.asarray(picture.reduce(_FINE))

    def _project(self, points: Any) -> list[tuple[float, float]]:
        """Points [m] on the picture."""
        turned = (np.asarray(points, np.float64) - self._centre) @ self._axes.T
        scale = _FINE * SIZE[1] * 0.6 / self._reach / (1.0 - turned[:, 2] / (4.5 * self._reach))
        x = _FINE * SIZE[0] / 2 + scale * turned[:, 0]
        y = _FINE * SIZE[1] / 2 - scale * turned[:, 1]
        return list(zip(x.tolist(), y.tolist(), strict=True))

    def _background(self) -> Image.Image:
        picture = Image.new("RGB", (SIZE[0] * _FINE, SIZE[1] * _FINE), _SKY)
        pen = ImageDraw.Draw(picture)
        ground, radius = self._centre * [1.0, 1.0, 0.0], 0.88 * self._reach
        pen.polygon(self._project(ground + radius * _CIRCLE), _FLOOR)
        step = 0.25 * 2.0 ** max(0.0, np.ceil(np.log2(radius / 1.6)))
        for offset in np.arange(-np.floor(radius / step) * step, radius, step):
            half = np.sqrt(radius**2 - offset**2)
            for line in (
                ((offset, -half, 0.0), (offset, half, 0.0)),
                ((-half, offset, 0.0), (half, offset, 0.0)),
            ):
                pen.line(self._project(ground + np.array(line)), _GRID, _FINE)
        pen.line(self._project(self._path * [1, 1, 0]), _SHADOW, 2 * _FINE, "curve")
        pen.line(self._project(self._path), _PATH, 2 * _FINE, "curve")
        return picture

    def _draw_trail(self, pen: ImageDraw.ImageDraw) -> None:
        if len(self._trail) > 1:
            pen.line(self._project(list(self._trail)), _TRAIL, 2 * _FINE, "curve")

    def _draw_setpoint(
        self, pen: ImageDraw.ImageDraw, setpoint: np.ndarray, position: np.ndarray
    ) -> None:
        (x, y), (u, v) = self._project([setpoint, position])
        pen.line([(x, y), (u, v)], _SETPOINT, _FINE)
        size = 4.5 * _FINE
        pen.ellipse((x - size, y - size, x + size, y + size), _SKY, _SETPOINT, 2 * _FINE)

    def _draw_drone(
        self,
        pen: ImageDraw.ImageDraw,
        position: np.ndarray,
        rotation: np.ndarray,
        speed: np.ndarray,
    ) -> None:
        arm, down = self._arm, np.array([1.0, 1.0, 0.0])
        hubs = position + arm * self._hubs @ rotation.T
        for hub in hubs:
            disc = (hub + 0.55 * arm * _CIRCLE @ rotation.T) * down
            pen.polygon(self._project(disc), _SHADOW)
        pen.line(self._project([position * down, position]), _GRID, _FINE)
        up = rotation[:, 2]
        for number in np.argsort(hubs @ self._axes[2]):
            hub, colour = hubs[number], _FRONT if self._hubs[number, 0] > 1e-3 else _BACK
            pen.line(self._project([position, hub]), _INK, 4 * _FINE)
            disc = self._project(hub + 0.12 * arm * up + 0.55 * arm * _CIRCLE @ rotation.T)
            pen.polygon(disc, tuple(round(0.72 * 255 + 0.28 * c) for c in colour), colour, _FINE)
            tip = hub + up * arm * (0.12 + 1.5 * speed[number] ** 2)
            pen.line(self._project([hub + 0.12 * arm * up, tip]), colour, 3 * _FINE)
        nose = position + rotation @ np.array([0.5 * arm, 0.0, 0.0])
        pen.line(self._project([position, nose]), _FRONT, 5 * _FINE)
        (x, y), size = self._project([position])[0], 5 * _FINE
        pen.ellipse((x - size, y - size, x + size, y + size), _INK)
