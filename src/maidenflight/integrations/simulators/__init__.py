"""Simulators by others, in which drones are flown: PyBullet, l2f and crazyflow."""
