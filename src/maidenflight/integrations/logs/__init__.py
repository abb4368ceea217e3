"""Readers of logs by others: PX4, Betaflight, ROS, Crazyflie and published data sets."""
