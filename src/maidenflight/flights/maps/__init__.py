"""Which parts of a log are which signal of a drone, where a person has to say it."""
