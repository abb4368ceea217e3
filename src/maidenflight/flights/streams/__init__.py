"""Joins signals that were logged apart, each at its own rate."""
