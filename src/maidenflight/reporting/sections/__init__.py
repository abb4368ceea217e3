"""Sections of the page: pictures and tables, filled into their templates."""
