"""Rigs, clips, four-camera inputs, the policy contract, and the frame of the command line, reports and benchmarks."""

__version__ = "0.1.0"
