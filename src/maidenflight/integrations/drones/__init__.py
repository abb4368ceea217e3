"""Drones for other simulators and autopilots, a module a format."""
