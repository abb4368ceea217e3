"""What a drone is to do: reference paths, rewards, and the ends of episodes."""
