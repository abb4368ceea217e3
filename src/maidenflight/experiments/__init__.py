"""Transfer: policies in realities that they have never seen."""
