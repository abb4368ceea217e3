"""Windows simulated open loop: the paper's objective, and errors of prediction."""
