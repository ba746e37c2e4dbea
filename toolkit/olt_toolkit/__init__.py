"""Rigs, clips, four-camera inputs, the policy contract, and the frame of the command line, reports and benchmarks."""

from olt_generator.version import __version__ as __version__
