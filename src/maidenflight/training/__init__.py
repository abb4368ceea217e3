"""Training: from a distribution of drones to policies."""
