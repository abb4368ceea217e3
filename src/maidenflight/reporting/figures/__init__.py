"""Figures of the page and of files, as Vega-Lite."""
