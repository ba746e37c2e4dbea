"""The view engine: one front-camera video to an ego trajectory, depth, warps and the views of a target rig.

The package stands alone and imports nothing else of the project.
"""

from olt_generator.version import __version__ as __version__
