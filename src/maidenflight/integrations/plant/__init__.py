"""A simulated drone for a firmware elsewhere, in lock-step or for CrazySim."""
