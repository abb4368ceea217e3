"""Policies by others: networks in ONNX and of Stable-Baselines3, and controllers."""
