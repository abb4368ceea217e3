"""RAPTOR: its policy, policies of its form, and its checkpoint."""
