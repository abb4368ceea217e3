"""The rigid body, its motors, battery, sensors and delays."""
