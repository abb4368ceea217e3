"""Realities for policies: virtual drones, wrappers around them, and foreign simulators."""
