"""Deployment: from a trained policy to what a drone runs."""
