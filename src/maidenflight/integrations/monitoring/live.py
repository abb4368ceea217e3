"""A live view by rerun, an extra package: flights in space, and training while it runs.

Data goes to the viewer, which is started, or into a file for it. A drone is an entity with its
path, its reference, the current set-point, thrusts as arrows, and time series beside it.
"""

import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from maidenflight.errors import InputError, WriteError, imported
from maidenflight.flights.log import Flight
from maidenflight.reporting.run import usable
from maidenflight.simulator.physics import geometry

if TYPE_CHECKING:
    from maidenflight.policy import Policy
    from maidenflight.training.train import Progress

_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
"""Environment variables that name a display on Linux."""
_LONGEST_WAIT = 10.0
"""For a viewer to take what it was sent [s]."""
TABBED = 12
"""Flights that have a tab of their own; the others are in the picture of all."""
TIME = "time"
"""Timeline of flights [s]; in training, flights of the best policy follow each other on it."""
STEPS = "simulated steps"
"""Timeline of training."""
_REACH = 0.06
"""From the drawn drone's centre to a rotor [m], half as much again as a Crazyflie's, to be
visible."""
_BLUE, _ORANGE, _GREEN = (0, 103, 165), (194, 77, 0), (0, 120, 90)
_PURPLE, _GREY, _INK = (148, 64, 138), (140, 148, 158), (60, 66, 74)
_HUBS = _REACH * geometry.ROTORS
_SERIES = {
    "position_error": ("Position error [cm]", {"error": _BLUE}),
    "attitude": ("Attitude [deg]", {"roll": _BLUE, "pitch": _ORANGE, "yaw": _GREEN}),
    "body_rates": ("Body rates [deg/s]", {"x": _BLUE, "y": _ORANGE, "z": _GREEN}),
    "command": ("Motor commands", {"1": _BLUE, "2": _ORANGE, "3": _GREEN, "4": _PURPLE}),
}
"""Time series of a flight: title, and its lines with their colours."""


def show_flights(flights: Sequence[Flight], path: Path | None = None) -> None:
    """Shows flights, all beginning at time zero.

    Args:
        flights: one or more, of any source.
        path: an .rrd file for rerun; the viewer is started by default.

    Raises:
        InputError: rerun is not installed, or there is no row to show.
        WriteError: the file cannot be written.
    """
    parts = [
        part
        for flight in flights
        if len(part := flight.part(*usable(flight).indices(len(flight))[:2]))
    ]
    if not parts:
        raise InputError("no flight to view: none of the logs has a row.")
    rerun, blueprint = _packages()
    names = [f"{number:03d}_{_word(flight.name)}" for number, flight in enumerate(parts, 1)]
    tabs = [
        _flight_view(blueprint, name, flight)
        for name, flight in zip(names[:TABBED], parts, strict=False)
    ]
    if len(names) > 1:
        eye = _eye(blueprint, parts)
        tabs.insert(0, blueprint.Spatial3DView(name="All flights", origin="/", eye_controls=eye))
    with _recording(rerun, path, _layout(blueprint, blueprint.Tabs(*tabs))) as recording:
        for name, flight in zip(names, parts, strict=True):
            _describe(rerun, recording, name)
            _log_flight(rerun, recording, name, flight, 0.0, static=True)


@contextmanager
def training(
    fly: Callable[["Policy"], Flight], path: Path | None = None
) -> Iterator[Callable[["Progress"], None]]:
    """Shows training while it runs: scores of all policies, and how the best one flies.

    Args:
        fly: lets a policy fly once.
        path: an .rrd file for rerun, which grows as training goes on; the viewer is started unless
            given.

    Yields:
        What to call with each score.

    Raises:
        InputError: rerun is not installed.
        WriteError: the file cannot be written.
    """
    rerun, blueprint = _packages()
    began, viewer_open = 0.0, True
    with _recording(rerun, path, _training_view(blueprint)) as recording:
        _describe(rerun, recording, "best")

        def show(progress: "Progress") -> None:
            nonlocal began, viewer_open
            if not viewer_open:
                return
            recording.set_time(STEPS, sequence=int(progress.steps))
            recording.set_time(TIME, duration=began)
            for name, values in progress.score._asdict().items():
                scale = {"survival": 100.0, "position_error": 100.0}.get(name, 1.0)
                for number, value in enumerate(np.asarray(values), 1):
                    recording.log(
                        f"scores/{name}/policy_{number}", rerun.Scalars(scale * float(value))
                    )
            if progress.best is not None:
                flight = fly(_best(progress))
                if began == 0.0:
                    recording.send_blueprint(_training_view(blueprint, flight))
                _log_flight(rerun, recording, "best", flight, began, static=False)
                began += flight.duration + 0.5
            viewer_open = _sent(recording)
            if not viewer_open:
                print("the viewer is gone; training goes on without it", file=sys.stderr)

        yield show


def _training_view(blueprint: Any, flight: Flight | None = None) -> Any:
    """Scores beside the best policy's flight, from where such a flight is in view."""
    titles = {
        "episode_return": "Return",
        "survival": "Survival [%]",
        "position_error": "Position error [cm]",
    }
    scores = [
        blueprint.TimeSeriesView(name=title, origin=f"scores/{name}")
        for name, title in titles.items()
    ]
    views = blueprint.Horizontal(
        blueprint.Vertical(*scores), _flight_view(blueprint, "best", flight), column_shares=[1, 2]
    )
    return _layout(blueprint, views)


def _best(progress: "Progress") -> "Policy":
    """The policy of the highest return now, as it was at its own best score."""
    import jax

    number = int(np.argmax(np.asarray(progress.score.episode_return)))
    return jax.tree.map(lambda leaf: leaf[number], progress.best)


def _packages() -> tuple[Any, Any]:
    names = ("rerun", "rerun.blueprint")
    rerun, blueprint = (imported(name, "viewer", "the viewer") for name in names)
    return rerun, blueprint


@contextmanager
def _recording(rerun: Any, path: Path | None, layout: Any) -> Iterator[Any]:
    """A stream into the viewer or a file, closed at the end."""
    has_display = sys.platform != "linux" or any(map(os.environ.get, _DISPLAYS))
    if path is None and not has_display:
        raise InputError(
            "the viewer needs a display, and there is none. Write a file instead, with -o "
            "FILE.rrd (train: --view FILE.rrd), and open it where there is one: rerun FILE.rrd"
        )
    recording = rerun.RecordingStream("maidenflight")
    if path is None:
        recording.spawn(default_blueprint=layout)
    else:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # Rerun reports a file that cannot be written only in its log.
            path.touch()
        except OSError as error:
            raise WriteError(path, error) from error
        recording.save(path, default_blueprint=layout)
    try:
        yield recording
    finally:
        _sent(recording)
        recording.disconnect()


def _sent(recording: Any) -> bool:
    """Sends what was logged; false where the viewer was closed."""
    try:
        recording.flush(timeout_sec=_LONGEST_WAIT)
    except RuntimeError:
        return False
    return True


def _word(name: str) -> str:
    """A name as part of an entity's path."""
    return re.sub(r"[^\w-]", "_", name.rpartition("/")[2].removesuffix(".csv"))


def _layout(blueprint: Any, views: Any) -> Any:
    small: Any = {"state": "collapsed"}
    panels = blueprint.BlueprintPanel(**small), blueprint.SelectionPanel(**small)
    return blueprint.Blueprint(views, *panels, blueprint.TimePanel(**small, timeline=TIME))


def _flight_view(blueprint: Any, entity: str, flight: Flight | None = None) -> Any:
    """A flight in space beside its time series; a known one is in view as a whole."""
    lines = [
        blueprint.TimeSeriesView(name=title, origin=f"{entity}/{series}")
        for series, (title, _) in _SERIES.items()
    ]
    eye = {} if flight is None else {"eye_controls": _eye(blueprint, [flight])}
    space = blueprint.Spatial3DView(name="In space", origin=entity, **eye)
    return blueprint.Horizontal(
        space, blueprint.Vertical(*lines), name=entity, column_shares=[3, 2]
    )


def _eye(blueprint: Any, flights: Sequence[Flight]) -> Any:
    """Looks at flights from the front right above."""
    ends = np.array(
        [(flight.position.min(axis=0), flight.position.max(axis=0)) for flight in flights]
    )
    low, high = ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)
    middle, reach = (low + high) / 2, max(float(np.linalg.norm(high - low)), 0.8)
    return blueprint.EyeControls3D(
        position=middle + 1.3 * reach * np.array([0.6, -1.0, 0.6]),
        look_target=middle,
        eye_up=[0, 0, 1],
    )


def _describe(rerun: Any, recording: Any, entity: str) -> None:
    """What of a drone does not change: its shape, and names and colours of its lines."""
    recording.log(entity, rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    turn = np.linspace(0, 2 * np.pi, 33)
    disc = 0.5 * _REACH * np.stack([np.cos(turn), np.sin(turn), np.full(33, 0.2)], axis=1)
    colours = [_ORANGE if front else _INK for front in geometry.FRONT]
    lines = [np.stack([np.zeros(3), hub]) for hub in _HUBS]
    arms = rerun.LineStrips3D(lines, colors=colours, radii=0.004)
    rotors = rerun.LineStrips3D([hub + disc for hub in _HUBS], colors=colours, radii=0.0015)
    recording.log(f"{entity}/drone/arms", arms, static=True)
    recording.log(f"{entity}/drone/rotors", rotors, static=True)
    for series, (_, colours_of) in _SERIES.items():
        for name, colour in colours_of.items():
            look = rerun.SeriesLines(colors=[colour], names=[name])
            recording.log(f"{entity}/{series}/{name}", look, static=True)


def _log_flight(
    rerun: Any, recording: Any, entity: str, flight: Flight, began: float, *, static: bool
) -> None:
    """A flight from a time on.

    Its whole path is there from its beginning, or always where it is the entity's only one.
    """
    time = [rerun.TimeColumn(TIME, duration=began + flight.period * np.arange(len(flight)))]
    recording.reset_time() if static else recording.set_time(TIME, duration=began)
    path = rerun.LineStrips3D([flight.position], colors=[_BLUE], radii=0.002)
    recording.log(f"{entity}/path", path, static=static)
    if np.isfinite(flight.setpoint).all():
        reference = rerun.LineStrips3D([flight.setpoint], colors=[_GREY], radii=0.001)
        recording.log(f"{entity}/reference", reference, static=static)
        point = rerun.Points3D.columns(
            positions=flight.setpoint, colors=[_ORANGE] * len(flight), radii=[0.008] * len(flight)
        )
        recording.send_columns(f"{entity}/setpoint", time, point)
    turned = Rotation.from_euler("ZYX", flight.attitude[:, ::-1]).as_quat()
    moved = rerun.Transform3D.columns(translation=flight.position, quaternion=turned)
    recording.send_columns(f"{entity}/drone", time, moved)
    recording.send_columns(f"{entity}/drone/thrust", time, _thrusts(rerun, flight.command))
    for name, values in _lines(flight).items():
        recording.send_columns(f"{entity}/{name}", time, rerun.Scalars.columns(scalars=values))


def _thrusts(rerun: Any, command: Float[np.ndarray, "N 4"]) -> Any:
    """Commands as arrows up from the rotors, in the drone's own frame."""
    rows = len(command)
    vectors = np.zeros((rows, 4, 3))
    vectors[..., 2] = 2.0 * _REACH * command
    columns = rerun.Arrows3D.columns(
        origins=np.tile(_HUBS, (rows, 1)),
        vectors=vectors.reshape(-1, 3),
        colors=[_GREEN] * (4 * rows),
        radii=[0.003] * (4 * rows),
    )
    return columns.partition([4] * rows)


def _lines(flight: Flight) -> Mapping[str, Float[np.ndarray, "N"]]:
    """Time series by the entity below the flight's."""
    groups = {
        "attitude": np.degrees(flight.attitude),
        "body_rates": np.degrees(flight.body_rates),
        "command": flight.command,
    }
    lines = {
        f"{series}/{name}": values[:, place]
        for series, values in groups.items()
        for place, name in enumerate(_SERIES[series][1])
    }
    if np.isfinite(flight.setpoint).all():
        error = flight.position - flight.setpoint
        lines["position_error/error"] = 100.0 * np.linalg.norm(error, axis=1)
    return {name: np.asarray(values, np.float64) for name, values in lines.items()}
