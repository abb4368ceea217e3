"""Slowly changing torques and forces, estimated from flights by a Kalman filter."""
