"""A real Crazyflie by radio: recording flights, flying a policy on board, landing."""
