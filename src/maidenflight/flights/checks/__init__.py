"""Judges rows of a log: whether the drone flies, and whether the signals agree."""
