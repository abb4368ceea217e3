"""A drone in crazyflow, as a process of its own: `python -m ...crazyflow_process DRONE`.

crazyflow needs `SCIPY_ARRAY_API=1` before SciPy is first imported, which would change SciPy for
the whole program. So it runs apart, and here alone it is imported.

On standard input come frames of `REQUEST_SIZE` numbers in float64, on standard output go a line of
JSON and a frame of `ANSWER_SIZE` for each: a request is either four rotor speeds for a step, or
the state to begin with. The process ends with its input.
"""

import importlib
import json
import os
import sys
from typing import Any, BinaryIO

import numpy as np

RATE = 500
"""Steps a second [Hz], crazyflow's own (its sim/sim.py, version 0.4.0)."""
REQUEST_SIZE = 8
"""Numbers of a request, by definition: 0 and rotor speeds [rpm], or 1, position [m] and speeds."""
ANSWER_SIZE = 13
"""Numbers of an answer, by definition: position, velocity, quaternion x, y, z, w, body rates."""
STEP, BEGIN = 0.0, 1.0
"""The first number of a request."""


def main(drone: str) -> None:
    """Answers requests until there are no more.

    Args:
        drone: crazyflow's name of it.
    """
    # What libraries print belongs to standard error; the frames have a descriptor of their own.
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)
        simulation, limit = _world(drone)
        if simulation is None:
            answers.write(json.dumps({"drones": limit}).encode() + b"\n")
            return
        answers.write(json.dumps(_described(simulation, limit)).encode() + b"\n")
        answers.flush()
        _serve(simulation, sys.stdin.buffer, answers)


def _world(drone: str) -> tuple[Any, Any]:
    """A simulation and the largest thrust of a rotor [N]; or nothing, and the drones that are."""
    crazyflow: Any = importlib.import_module("crazyflow")
    physics: Any = importlib.import_module("crazyflow.dynamics")
    physical = crazyflow.Dynamics.first_principles
    names = [str(name) for name in crazyflow.Drone if physical in physics.supported_dynamics(name)]
    if drone not in names:
        return None, names
    drone_name, motors = crazyflow.Drone(drone), crazyflow.Control.rotor_vel
    simulation = crazyflow.Sim(drone=drone_name, dynamics=physical, control=motors, freq=RATE)
    return simulation, float(physics.load_params(physical, drone_name)["thrust_max"])


def _described(simulation: Any, thrust: float) -> dict[str, Any]:
    """The drone's constants, of one world and drone."""
    numbers = {
        name: np.asarray(value, np.float64).reshape(np.shape(value)).tolist()
        for name, value in vars(simulation.data.params).items()
    }
    return {**numbers, "thrust_max": thrust}


def _serve(simulation: Any, requests: BinaryIO, answers: BinaryIO) -> None:
    import jax.numpy as jnp

    simulation.reset()
    while len(frame := requests.read(8 * REQUEST_SIZE)) == 8 * REQUEST_SIZE:
        kind, *numbers = np.frombuffer(frame).tolist()
        if kind == BEGIN:
            simulation.reset()
            states = simulation.data.states.replace(
                pos=jnp.asarray([[numbers[:3]]], jnp.float32),
                rotor_vel=jnp.asarray([[numbers[3:]]], jnp.float32),
            )
            simulation.data = simulation.data.replace(states=states)
        else:
            simulation.rotor_vel_control(jnp.asarray([[numbers[:4]]], jnp.float32))
            simulation.step()
        states = simulation.data.states
        parts = (states.pos, states.vel, states.quat, states.ang_vel)
        answer = np.concatenate([np.ravel(part) for part in parts]).astype(np.float64)
        answers.write(answer.tobytes())
        answers.flush()


if __name__ == "__main__":
    main(sys.argv[1])
