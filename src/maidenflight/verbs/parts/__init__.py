"""Parts of verbs: what they print of logs and estimates, flights in realities, calibration."""
