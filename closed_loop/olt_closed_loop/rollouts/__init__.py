"""Rollouts: what a drive of a scene was, kept for scoring and in files."""
