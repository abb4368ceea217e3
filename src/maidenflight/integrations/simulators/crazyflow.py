"""`Crazyflow`: Crazyflies in crazyflow, a simulator in JAX, as realities of its own physics.

crazyflow is installed from PyPI (extra `crazyflow`) and runs in a process of its own
(`crazyflow_process`), since it needs another SciPy than the rest of the program.

Its first-principles drones are fitted to load cells: a thrust curve with a linear part, rotor speed
that rises and falls at rates of their own, with linear and quadratic terms, drag, and the rotors'
momentum. World, body, quaternion and motors are as ours; motors are commanded by rotor speed, here
sqrt(u) of the largest, and crazyflow clips to what it calls the least and the largest thrust. It is
integrated by explicit Euler at 500 Hz, its default. It has no battery, latency or noise, and none
of its controllers is used.

Source: Schuck et al. 2026 (arXiv 2606.01478; version 0.4.0).
"""

import importlib.util
import json
import math
import os
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError, optional
from maidenflight.integrations.simulators import crazyflow_process
from maidenflight.integrations.simulators.crazyflow_process import ANSWER_SIZE, BEGIN, RATE, STEP
from maidenflight.parameters import Parameters, crazyflie, noiseless, replace, x_frame
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.realities.reality import MOTORS, Truth

_RPM = 2 * math.pi / 60
"""rad/s of a revolution a minute, by definition."""


class Crazyflow:
    """A drone in crazyflow; follows the `Reality` protocol.

    Raises:
        InputError: no such drone, crazyflow is not installed, or its process ended.
    """

    rate = RATE
    takes = MOTORS

    def __init__(self, drone: str) -> None:
        """Starts its process.

        Args:
            drone: crazyflow's name of it, such as `cf21B_500`.
        """
        with optional("crazyflow", "crazyflow", "this drone", "1.2 GB"):
            if importlib.util.find_spec("crazyflow") is None:
                raise ImportError
        self.name = f"crazyflow:{drone}"
        # It prints much, and leaves a log of MuJoCo's in the folder that it is in.
        folder = tempfile.TemporaryDirectory(prefix="crazyflow-")
        self._said = Path(folder.name, "said")
        with self._said.open("wb") as log_file:
            self._process = subprocess.Popen(
                [sys.executable, "-m", crazyflow_process.__name__, drone],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log_file,
                cwd=folder.name,
                env={**os.environ, "SCIPY_ARRAY_API": "1"},
            )
        self.close = weakref.finalize(self, _end, self._process, folder)
        answer = json.loads(self._read_line())
        if "drones" in answer:
            raise InputError(f"crazyflow:{drone}: crazyflow has {', '.join(answer['drones'])}.")
        self._fastest = _rotor_speed(answer["thrust_max"], np.ravel(answer["rpm2thrust"]))
        self.parameters = _parameters(answer, self._fastest)
        self.hover = float(dynamics.hover_command(self.parameters))
        self.reset(np.zeros(3), 0)

    def reset(self, position: Float[np.ndarray, "3"], seed: int) -> None:
        """Resets to hover, level and at rest at a position [m]; nothing here is random."""
        self._command = np.full(4, self.hover)
        self._ask(BEGIN, *np.asarray(position, np.float64), *self._rotor_speeds())

    def step(self, command: Float[np.ndarray, "4"]) -> None:
        """Holds thrust commands for 2 ms."""
        self._command = np.clip(np.asarray(command, np.float64), 0.0, 1.0)
        self._ask(STEP, *self._rotor_speeds(), 0.0, 0.0, 0.0)

    def observe(self) -> Measurement:
        """Returns the true state."""
        parts: Any = np.split(self._state, (3, 6, 10))
        return Measurement(*parts)

    def truth(self) -> Truth:
        """Returns the true state and the last commands."""
        position, _, quaternion, rates = np.split(self._state, (3, 6, 10))
        return Truth(position, quaternion, rates, self._command)

    def _rotor_speeds(self) -> Float[np.ndarray, "4"]:
        return self._fastest * np.sqrt(self._command)

    def _ask(self, *numbers: float) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(np.array(numbers, np.float64).tobytes())
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise self._ended() from error
        frame = self._process.stdout.read(8 * ANSWER_SIZE)
        if len(frame) < 8 * ANSWER_SIZE:
            raise self._ended()
        self._state = np.frombuffer(frame)

    def _read_line(self) -> bytes:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise self._ended()
        return line

    def _ended(self) -> InputError:
        self._process.wait()
        output = self._said.read_text(errors="replace").strip().splitlines()
        self.close()
        return InputError(
            f"{self.name}: crazyflow's process ended ({output[-1] if output else 'no output'}). "
            "Try it alone with: SCIPY_ARRAY_API=1 python -c 'import crazyflow'."
        )


def _end(process: subprocess.Popen[bytes], folder: tempfile.TemporaryDirectory[str]) -> None:
    """Ends a process, closes what leads to it, and removes its folder."""
    process.terminate()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
    folder.cleanup()


def _rotor_speed(thrust: float, curve: Float[np.ndarray, "3"]) -> float:
    """Rotor speed [rpm] that gives a thrust [N] by a quadratic curve, constant first."""
    constant, linear, square = curve.tolist()
    return (math.sqrt(linear**2 + 4 * square * (thrust - constant)) - linear) / (2 * square)


def _parameters(answer: Mapping[str, Any], fastest: float) -> Parameters:
    """The nearest drone of our model: the rotors' lag and torque are those about hover."""
    mass, thrust = float(np.ravel(answer["mass"])[0]), np.ravel(answer["rpm2thrust"])
    gravity, full = -float(np.ravel(answer["gravity_vec"])[2]), float(answer["thrust_max"])
    hover = _rotor_speed(mass * gravity / 4, thrust)
    rise, rise_square, fall, fall_square = np.ravel(answer["rotor_dyn_coef"]).tolist()
    up, down = 1 / (rise + 2 * rise_square * hover), 1 / (fall + 2 * fall_square * hover)
    torque = float(np.polynomial.polynomial.polyval(hover, np.ravel(answer["rpm2torque"])))
    return replace(
        noiseless(crazyflie()),
        thrust_to_weight=4 * full / (mass * gravity),
        thrust_offset=float(thrust[0]) / full,
        thrust_linear=float(thrust[1]) * fastest / full,
        motor_time_constant=up,
        spin_down_ratio=down / up,
        latency=0.0,
        torque_to_thrust=torque / (mass * gravity / 4),
        torque_offset=0.0,
        rotor_momentum=float(np.ravel(answer["prop_inertia"])[0]) * fastest * _RPM,
        mass=mass,
        inertia=tuple(np.diag(np.reshape(answer["J"], (3, 3))).tolist()),
        **x_frame(float(np.ravel(answer["L"])[0]) * math.sqrt(2)),
        drag=tuple((-np.diag(np.reshape(answer["drag_matrix"], (3, 3))) / mass).tolist()),
        ground_effect=0.0,
        gravity=gravity,
        time_step=0.001,
    )
