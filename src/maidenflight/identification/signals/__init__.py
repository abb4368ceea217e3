"""What flights show by themselves: their signals, and the motors' lag."""
