"""What an identification is asked for and what it yields."""
