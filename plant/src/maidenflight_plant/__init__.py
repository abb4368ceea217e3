"""A drone of maidenflight as the physics of a firmware elsewhere, in lock-step or for CrazySim."""
