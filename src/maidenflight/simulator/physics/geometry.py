"""Geometry of a Crazyflie, for what knows no drone: logs on display or in check.

The rotors stand in an X about the centre of mass and are numbered as the Crazyflie's motors: 1
front right, 2 back right, 3 back left, 4 front left, in body axes with x forward, y left and z up.
Where a drone is known, `parameters.rotors` and `parameters.levers` tell its own geometry.
"""

import numpy as np

ROTORS = np.array([(1, -1, 0), (-1, -1, 0), (-1, 1, 0), (1, 1, 0)]) / np.sqrt(2)
"""Places of the rotors' hubs [arm length], (4, 3)."""
YAW = (-1, 1, -1, 1)
"""Sign of each rotor's reaction torque about z [-]: + turns the drone to the left, since the rotor
turns clockwise from above."""
TORQUES = np.sign(np.stack([ROTORS[:, 1], -ROTORS[:, 0], YAW])).T
"""Signs of each rotor's torque about x, y and z [-], (4, 3); Gronauer et al. 2022, eq:torque."""
