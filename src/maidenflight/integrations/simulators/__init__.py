"""Simulators by others, of drones: PyBullet, l2f and crazyflow."""
