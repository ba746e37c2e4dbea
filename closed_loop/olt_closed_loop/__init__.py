"""Scenes, vehicle, control, sensors, simulation and scoring of the closed loop."""
