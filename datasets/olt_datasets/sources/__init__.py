"""Readers that turn recordings of public formats into the form that clips are built from."""
