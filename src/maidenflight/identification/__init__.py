"""Identification: from flights to parameters with an interval."""
