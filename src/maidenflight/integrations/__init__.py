"""What speaks to other programs, formats and machines; the core names it by text alone."""
