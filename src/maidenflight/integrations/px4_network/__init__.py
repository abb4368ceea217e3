"""Policies for PX4's `mc_nn_control`, of the form of its network, and what it is built of."""
