"""Scoring: what a drive is worth, and whether that can be trusted."""
