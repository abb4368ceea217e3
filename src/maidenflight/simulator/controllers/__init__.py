"""Control structures between a policy and the motors, and the firmware's own controllers."""
