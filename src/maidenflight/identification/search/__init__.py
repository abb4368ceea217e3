"""Search of an optimum in a box of parameters."""
