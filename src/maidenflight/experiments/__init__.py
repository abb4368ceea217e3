"""Transfer: policies in unseen realities."""
