"""What policies are flown on: virtual drones, wrappers around them, and foreign simulators."""
