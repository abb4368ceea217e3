"""Engines of studies on many machines: Ray and SLURM."""
