"""References: continuous, of the stated size, period and start; way-points are passed, and bad
files are named by row."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from arrays import float32
from maidenflight.errors import InputError
from maidenflight.simulator.tasks import courses, tasks, trajectories, waypoints

PATH = ((0.0, 0.0, 0.0, 1.0), (1.0, 0.5, 0.0, 1.2), (1.5, 0.5, -0.5, 1.1), (3.0, 0.0, 0.2, 0.9))
SHAPES = {
    "circle": (trajectories.circle(), 3.0),
    "hold": (trajectories.hold(), 1.0),
    "climb": (trajectories.climb(), 1.5),
    "figure-eight": (trajectories.figure_eight(), 5.5),
    "pentagram": (waypoints.pentagram(), 5.0),
    "accelerating circle": (trajectories.accelerating_circle(2.5), 6.0),
    "zigzag": (waypoints.zigzag(PATH), 3.0),
    "minimum snap": (waypoints.minimum_snap(PATH), 3.0),
}
shapes = pytest.mark.parametrize("name", SHAPES)
periodic = pytest.mark.parametrize("name", ["circle", "figure-eight", "pentagram"])


MOST_TIMES = 3001
many = cache(lambda trajectory: jax.jit(jax.vmap(trajectory)))


def points(trajectory, times):
    """By one program for each trajectory, whatever the number of times."""
    padded = np.resize(float32(times), MOST_TIMES)
    return np.asarray(many(trajectory)(padded), np.float64)[: len(times)]


@cache
def velocity(trajectory):
    return lambda time: jax.jvp(trajectory, (time,), (jnp.ones_like(time),))[1]


@shapes
def test_a_reference_is_continuous_and_its_velocity_is_its_slope(name):
    trajectory, duration = SHAPES[name]
    times = np.linspace(-0.1 * duration, 1.1 * duration, 2401)
    path, slopes = points(trajectory, times), points(velocity(trajectory), times)
    step = times[1] - times[0]
    assert np.abs(np.diff(path, axis=0)).max() < 3 * step, "nothing here is faster than 3 m/s"
    slope = (path[2:] - path[:-2]) / (2 * step)
    wrong = np.any(np.abs(slope - slopes[1:-1]) > 0.02, axis=1)
    assert wrong.sum() <= 12, "only where a straight line ends"


@shapes
def test_a_reference_works_alone_in_a_batch_and_under_reverse_differentiation(name):
    trajectory, duration = SHAPES[name]
    times = float32(np.linspace(0.07, 0.93, 5) * duration)
    alone = [trajectory(jnp.float32(time)) for time in times]
    assert all(point.shape == (3,) and point.dtype == jnp.float32 for point in alone)
    np.testing.assert_allclose(points(trajectory, times), alone, atol=2e-6)
    backward = points(jax.grad(lambda time: jnp.sum(trajectory(time))), times)
    np.testing.assert_allclose(backward, points(velocity(trajectory), times).sum(axis=1), atol=1e-5)


@periodic
def test_a_closed_curve_starts_above_the_origin_and_repeats_after_its_period_and_not_before(name):
    trajectory, period = SHAPES[name]
    times = np.linspace(0, period, 40, endpoint=False)
    np.testing.assert_allclose(points(trajectory, [0.0])[0], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(
        points(trajectory, times + 3 * period), points(trajectory, times), atol=1e-5
    )
    for part in (2, 3, 5):
        assert (
            np.abs(points(trajectory, times + period / part) - points(trajectory, times)).max()
            > 0.1
        )
    assert np.ptp(points(trajectory, times)[:, 2]) == 0


@pytest.mark.parametrize("period", [trajectories.SLOW, trajectories.NORMAL, trajectories.FAST])
def test_a_figure_eight_crosses_its_centre_twice_a_period_once_each_way(period):
    trajectory = trajectories.figure_eight(period, width=1.6, height=0.8)
    times = np.linspace(0, period, 1000, endpoint=False)
    path = points(trajectory, times)
    distance = np.linalg.norm(path - [0, 0, 0.8], axis=1)
    near = distance < np.roll(distance, 1)
    crossings = times[near & (distance <= np.roll(distance, -1)) & (distance < 0.01)]
    np.testing.assert_allclose(crossings, [0, period / 2], atol=period / 1000)
    heading = points(velocity(trajectory), [0, period / 2])
    np.testing.assert_allclose(
        heading[:, :2] * period / (2 * np.pi), [[0.4, 0.4], [-0.4, 0.4]], atol=1e-5
    )
    np.testing.assert_allclose([path[:, 0].max(), path[:, 0].min()], [0.8, -0.8], rtol=1e-4)
    np.testing.assert_allclose(
        distance**4, 0.64 * (path[:, 0] ** 2 - path[:, 1] ** 2), atol=1e-6
    )  # Bernoulli's equation


@pytest.mark.parametrize(
    ("make", "length"),
    [(trajectories.accelerating_circle, 1.0), (trajectories.accelerating_figure_eight, 2.0)],
)
def test_a_quickening_reference_starts_at_rest_and_gains_speed_evenly_to_its_fastest(make, length):
    """The distance on a circle is by hand: half of the fastest times the time, to the end."""
    reference, end, period = make(2.0), trajectories.RAMP_DURATION_S, np.pi * length / 2.0
    times = np.linspace(0.0, end, 3001)
    speeds = np.linalg.norm(points(velocity(reference), times), axis=1)
    after = np.linspace(end, end + period, 3001)
    late = np.linalg.norm(points(velocity(reference), after), axis=1)
    assert speeds[0] == 0.0
    assert late.max() == pytest.approx(2.0, rel=1e-3)
    assert np.all(speeds <= 2.0 * times / end + 1e-3)
    np.testing.assert_allclose(*points(reference, [end + 1.0, end + 1.0 + period]), atol=1e-3)
    if make is trajectories.accelerating_circle:
        np.testing.assert_allclose(speeds, 2.0 * times / end, atol=1e-3)
        assert np.trapezoid(speeds, times) == pytest.approx(0.5 * 2.0 * end, rel=1e-4)


def test_a_hastening_path_is_the_same_and_three_times_as_fast_in_the_end():
    plain = trajectories.circle()
    reference = trajectories.hastening(plain, 3.0)
    # By hand: 30 s and half of twice 30 s more.
    np.testing.assert_allclose(
        points(reference, [0.0, 15.0, 31.0]),
        points(plain, [0.0, 22.5, 63.0]),
        atol=1e-4,
    )
    speeds = np.linalg.norm(points(velocity(reference), [0.0, 15.0, 31.0]), axis=1)
    np.testing.assert_allclose(speeds / (np.pi * 0.5 / 3.0), [1.0, 2.0, 3.0], rtol=1e-4)


def test_a_circle_from_rest_never_accelerates_as_a_jump_would():
    """The phase is by hand: half of the ramp is lost; the acceleration is that of 7 degrees."""
    plain, reference = trajectories.circle(), tasks.circle().reference
    times = np.linspace(0.0, 4.5, 451)
    acceleration = np.linalg.norm(points(velocity(velocity(reference)), times), axis=1)
    assert acceleration[0] < 1e-3
    assert acceleration.max() < 9.81 * np.tan(np.radians(7.0))
    assert np.abs(np.diff(acceleration)).max() < 0.03
    np.testing.assert_allclose(
        points(reference, [1.5, 2.0, 7.7]),
        points(plain, [0.75, 1.25, 6.95]),
        atol=1e-5,
    )
    at_once = tasks.circle(ramp=0.0).reference
    np.testing.assert_allclose(at_once(jnp.float32(1.0)), plain(jnp.float32(1.0)), atol=1e-6)


def test_a_pentagram_has_five_equal_edges_at_one_speed_and_corners_of_36_degrees():
    trajectory = waypoints.pentagram(diameter=1.0, period=4.0, height=0.6)
    corners = points(trajectory, np.arange(6) * 0.8)
    edges = np.diff(corners, axis=0)
    np.testing.assert_allclose(np.linalg.norm(edges, axis=1), np.sin(np.radians(72)), rtol=1e-5)
    turns = np.sum(edges * np.roll(edges, -1, axis=0), axis=1) / np.sin(np.radians(72)) ** 2
    np.testing.assert_allclose(turns, -np.cos(np.radians(36)), rtol=1e-5)
    np.testing.assert_allclose(
        points(trajectory, (np.arange(5) + 0.5) * 0.8), (corners[1:] + corners[:-1]) / 2, atol=1e-6
    )
    np.testing.assert_allclose(corners[:, 2], 0.6, rtol=1e-6)


def test_a_climb_ends_at_its_height_after_its_duration_and_never_sinks():
    trajectory = trajectories.climb(height=0.8, duration=2.0)
    path = points(trajectory, [-1.0, 0.0, 1.0, 2.0, 9.0])
    np.testing.assert_allclose(
        path, [[0, 0, 0], [0, 0, 0], [0, 0, 0.4], [0, 0, 0.8], [0, 0, 0.8]], atol=1e-6
    )
    rising = points(velocity(trajectory), np.linspace(0, 2, 101))[:, 2]
    assert rising.min() >= 0
    np.testing.assert_allclose([rising[0], rising[50], rising[-1]], [0, 1.875 * 0.4, 0], atol=1e-6)


@pytest.mark.parametrize("kind", [waypoints.zigzag, waypoints.minimum_snap])
@pytest.mark.parametrize("path", [PATH, PATH[:2]])
def test_every_way_point_is_passed_in_time_and_the_ends_are_held(kind, path):
    table = np.array(path)
    trajectory = kind(path)
    np.testing.assert_allclose(points(trajectory, table[:, 0]), table[:, 1:], atol=1e-5)
    np.testing.assert_allclose(
        points(trajectory, [-1.0, table[-1, 0] + 5]), table[[0, -1], 1:], atol=1e-5
    )


def test_a_zigzag_is_straight_and_leaves_its_corners_in_the_new_direction():
    trajectory = waypoints.zigzag(PATH)
    np.testing.assert_allclose(
        points(trajectory, [0.25, 2.25]), [[0.125, 0, 1.05], [0.25, -0.15, 1.0]], atol=1e-6
    )
    speeds = [[0.5, 0, 0.2], [0, -1, -0.2], [-1 / 3, 0.7 / 1.5, -0.2 / 1.5], [0, 0, 0]]
    np.testing.assert_allclose(
        points(velocity(trajectory), [row[0] for row in PATH]), speeds, atol=1e-6
    )


def test_a_curve_of_least_snap_rests_at_its_ends_and_four_derivatives_have_no_steps():
    derivative = waypoints.minimum_snap(PATH)
    for order in range(1, 5):
        derivative = velocity(derivative)
        if order <= 3:
            np.testing.assert_allclose(points(derivative, [0.0, 3.0]), 0, atol=1e-3)
        for corner in (1.0, 1.5):
            before, at = points(derivative, [corner - 1e-5, corner])
            np.testing.assert_allclose(before, at, atol=1e-3 * np.abs(at).max())
            assert np.abs(at).max() > 0.1, "it does not stop there"


def test_two_points_give_the_curve_of_least_snap_between_them():
    times = np.linspace(0, 1.5, 50)
    smooth = waypoints.minimum_snap(((0.0, 0.0, 0.0, 0.0), (1.5, 0.0, 0.0, 1.0)))
    s = times / 1.5
    height = 35 * s**4 - 84 * s**5 + 70 * s**6 - 20 * s**7
    np.testing.assert_allclose(points(smooth, times)[:, 2], height, atol=1e-5)


def test_the_same_arguments_give_the_same_object_so_that_nothing_compiles_twice(tmp_path):
    path, again = PATH, tuple(map(tuple, np.array(PATH).tolist()))
    assert waypoints.zigzag(path) is waypoints.zigzag(again)
    assert waypoints.minimum_snap(path) is waypoints.minimum_snap(again)
    assert trajectories.figure_eight(3.5) is trajectories.figure_eight(trajectories.FAST)
    assert (
        trajectories.circle()
        is trajectories.circle(0.5, height=1.0)
        is not trajectories.circle(0.5, height=2.0)
    )
    assert waypoints.pentagram() is waypoints.pentagram(diameter=0.5)
    assert (
        trajectories.hold((0.0, 0.0, 1.0))
        is trajectories.hold((0.0, 0.0, 1.0))
        is not trajectories.hold((0.0, 0.0, 2.0))
    )
    assert trajectories.climb(1.0) is trajectories.climb(1.0)
    for name in ("one.csv", "two.csv"):
        (tmp_path / name).write_text("time,x,y,z\n0,0,0,1\n1,1,0,1\n")
    assert waypoints.waypoints(tmp_path / "one.csv") is waypoints.waypoints(tmp_path / "two.csv")


def test_a_way_point_file_is_read_as_it_was_written_and_its_clock_starts_at_zero(tmp_path):
    file = tmp_path / "path.csv"
    rows = [f"{x},{time + 100},{z},{y},note" for time, x, y, z in PATH]
    file.write_text("\ufeffx, time, z, y, comment\n" + "\n".join(rows) + "\n\n", encoding="utf-8")
    np.testing.assert_allclose(waypoints.read_waypoints(file), PATH, atol=1e-12)
    times = np.linspace(0, 3, 20)
    np.testing.assert_allclose(
        points(waypoints.waypoints(file), times), points(SHAPES["zigzag"][0], times), atol=1e-6
    )
    np.testing.assert_allclose(
        points(waypoints.waypoints(file, smooth=True), times),
        points(SHAPES["minimum snap"][0], times),
        atol=1e-6,
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "missing column x, y, z"),
        ("0,0,0,1\n1,0,0,1\n", "expected a header line with t,x,y,z"),
        ("t,x,y,z,yaw\n0,0,0,1,0\n1,0,0,1,0.5\n", "line 3: a yaw"),
        ("x,y,z\n0,0,1\n0,0,1\n", "line 3: the same place as before"),
        ("t,time,x,y,z\n0,0,0,0,1\n", "twice column time"),
        ("x,y,z\n0,0,1\n1,0,1,0\n", "line 3 has more cells"),
        ("time,x,z\n0,0,1\n1,0,1\n", "missing column y;"),
        ("time,x,y,z\n", "0 way-points; expected two or more"),
        ("time,x,y,z\n0,0,0,1\n", "1 way-points; expected two or more"),
        ("time,x,y,z\n0,0,0,1\n1,a,0,1\n", "line 3: x is 'a'; expected a number"),
        ("time,x,y,z\n0,0,0\n1,0,0,1\n", "line 2: z is None; expected a number"),
        ("time,x,y,z\n0,0,0,1\n1,,0,1\n", "line 3: x is ''; expected a number"),
        (
            "time,x,y,z\n0,0,0,1\n\n1,0,nan,1\n",
            "line 4 is (1.0, 0.0, nan, 1.0); expected four finite numbers",
        ),
        (
            "time,x,y,z\ninf,0,0,1\n1,0,0,1\n",
            "line 2 is (inf, 0.0, 0.0, 1.0); expected four finite",
        ),
        (
            "time,x,y,z\n0,0,0,1\n1,1e39,0,1\n",
            "line 3 is (1.0, 1e+39, 0.0, 1.0); expected four finite",
        ),
        (
            "time,x,y,z\n0,0,0,1\n1,0,0,1\n1,0,0,1\n",
            "line 4: time goes from 1.0 to 1.0 s; expected it to increase",
        ),
        ("time,x,y,z\n0,0,0,1\n2,0,0,1\n1,0,0,1\n", "line 4: time goes from 2.0 to 1.0 s"),
        (
            "time,x,y,z\n0,0,0,1\n1,3,4.1,1\n",
            "line 3: 5.1 m/s from the point before it, but at most 5 m/s",
        ),
    ],
)
def test_a_bad_way_point_file_is_refused_with_file_row_and_cure(tmp_path, text, message):
    file = tmp_path / "path.csv"
    file.write_text(text)
    with pytest.raises(InputError) as raised:
        waypoints.waypoints(file)
    assert str(raised.value).startswith(str(file))
    assert message in str(raised.value)


def test_an_unreadable_file_is_refused_and_a_fast_path_can_be_allowed(tmp_path):
    fast, binary = tmp_path / "fast.csv", tmp_path / "binary.csv"
    fast.write_text("time,x,y,z\n0,0,0,1\n1,6,0,1\n")
    binary.write_bytes(b"time,x,y,z\n\xff\xfe\n")
    assert waypoints.read_waypoints(fast, fastest=7.0)[-1] == (1.0, 6.0, 0.0, 1.0)
    for file in (tmp_path / "absent.csv", tmp_path, binary):
        with pytest.raises(InputError, match="not a readable CSV file"):
            waypoints.read_waypoints(file)


@pytest.mark.parametrize("kind", [waypoints.zigzag, waypoints.minimum_snap])
def test_bad_way_points_given_in_python_are_refused_by_number(kind):
    for path, message in [
        (((0.0, 0.0, 0.0, 1.0),), "1 way-points"),
        ((PATH[0], (1.0, 0.0, 0.0)), "way-point 2 is"),
        ((PATH[0], (1.0, 0.0, np.nan, 1.0)), "way-point 2 is"),
        ((PATH[1], PATH[0]), "way-point 2: time goes from 1.0 to 0.0"),
    ]:
        with pytest.raises(InputError, match=message):
            kind(path)


def test_way_points_without_time_are_passed_with_least_snap_and_within_their_limits(tmp_path):
    file = tmp_path / "places.csv"
    places = [(0, 0, 1), (0.5, 0.1, 1.2), (0.6, -0.8, 1), (2.5, 0, 1)]
    file.write_text("x,y,z\n" + "".join(f"{x},{y},{z}\n" for x, y, z in places))
    trajectory, duration = waypoints.read_reference(file)
    table = np.array(waypoints.read_waypoints(file))
    np.testing.assert_allclose(table[:, 1:], places, atol=1e-12)
    times = np.linspace(0, duration, 400)
    speed, acceleration = (
        np.linalg.norm(points(slope, times), axis=1).max()
        for slope in (velocity(trajectory), velocity(velocity(trajectory)))
    )
    assert speed <= 1.01
    assert acceleration <= 2.52
    assert speed > 0.98 or acceleration > 2.45, "one of them decides"

    def snap(times):
        at = np.linspace(0, times[-1], 4001)
        fourth = waypoints.snap_spline(times, table[:, 1:])(at, nu=4)
        return np.trapezoid(np.sum(fourth**2, axis=1), at)

    least = snap(table[:, 0])
    for number in (1, 2):
        for shift in (-0.05, 0.05):
            moved = table[:, 0].copy()
            moved[number] += shift
            assert snap(moved) > least


def test_rows_in_motion_are_flown_up_to_from_rest(tmp_path):
    file, times = tmp_path / "circle.csv", np.arange(0.0, 4.0, 0.02)
    places = 0.5 * np.sin(2 * times), 0.5 * np.cos(2 * times)
    rows = "".join(f"{t},{x},{y},1\n" for t, x, y in zip(times, *places, strict=True))
    file.write_text(f"t,x,y,z\n{rows}")
    trajectory, duration = waypoints.read_reference(file)
    at = np.linspace(0.0, duration, 300)
    there, slope = points(trajectory, at), points(velocity(trajectory), at)
    push = np.linalg.norm(points(velocity(velocity(trajectory)), at), axis=1)
    np.testing.assert_allclose(np.hypot(there[:, 0], there[:, 1]), 0.5, atol=1e-4)
    np.testing.assert_allclose(there[[0, -1], 0], places[0][[0, -1]], atol=1e-4)
    speeds = np.linalg.norm(slope, axis=1)
    np.testing.assert_allclose(speeds[[0, 150, -1]], [0.0, 1.0, 0.0], atol=1e-3)
    assert push.max() < np.hypot(2.0, waypoints.CRUISE_M_S2)
    assert duration == pytest.approx(times[-1] + 1.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,x,y,z\n0,0,0,1\n1,1,0,-0.1\n", "a height of -0.1 m"),
        ("t,x,y,z\n0,0,0,1\n1,4,0,1\n", r"up to 8\.8 m/s and 29\.6"),
    ],
)
def test_a_reference_that_no_drone_follows_is_refused(tmp_path, text, message):
    file = tmp_path / "path.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=message):
        tasks.find_task(str(file))


def test_a_course_starts_at_rest_and_is_smooth_and_as_fast_as_its_parts():
    course = courses.random_course(120.0, seed=0)
    times = np.arange(0.0, 120.0, 0.02)
    np.testing.assert_allclose(points(course, [0.0, 0.9]), [[0, 0, 1]] * 2, atol=1e-6)
    speeds = np.linalg.norm(points(velocity(course), times), axis=1)
    pushes = np.linalg.norm(points(velocity(velocity(course)), times), axis=1)
    assert 1.0 < speeds.max() < 1.5
    assert 2.5 < pushes.max() < 6.0
    assert np.quantile(speeds, 0.1) < 0.1, "it hovers too"
    assert np.ptp(points(course, times)[:, 2]) > 0.3
    assert courses.random_course(120.0, seed=0) is course
    assert np.abs(points(courses.random_course(120.0, seed=1), times) - points(course, times)).max()


def test_a_function_that_makes_no_task_is_refused_in_a_line(tmp_path, monkeypatch):
    (tmp_path / "own_tasks.py").write_text("def reward(state, setpoint): return 1.0\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(InputError, match=r"own_tasks:reward.*setpoint"):
        tasks.find_task("own_tasks:reward")
