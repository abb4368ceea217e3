"""Request and result of an identification."""
