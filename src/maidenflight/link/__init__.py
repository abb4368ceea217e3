"""A real Crazyflie by radio: recording flights, handing over to a policy on board, and coming down
whatever happens.
"""
