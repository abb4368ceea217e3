"""The simulator: a quadrotor is a pure function of its state, a command and xi."""
