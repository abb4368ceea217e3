"""Simulated flights: pilots, scenarios, the engine that flies them, and their logs."""
