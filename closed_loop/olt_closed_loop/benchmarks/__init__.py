"""Measurements of error against run time that `olt bench` runs."""
