"""Simulation: a policy drives the vehicle through a scene."""
