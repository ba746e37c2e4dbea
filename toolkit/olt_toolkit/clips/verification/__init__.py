"""Verification: whether a stored clip is what its tables say, each check a measurement with a verdict."""
