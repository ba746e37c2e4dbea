"""Camera models, one a module, gathered under one name.

Convention: pixel (u, v) has its origin in the centre of the top-left pixel, u to the right, v down, so the pixel in
row i and column j is sampled at exactly (j, i). Camera axes are x right, y down, z forward. Rays are unit vectors.
"""

from olt_generator.lenses.brown_conrady import BrownConradyCamera
from olt_generator.lenses.camera_model import Camera, Mask, fit_camera, pixel_rays
from olt_generator.lenses.ftheta import FthetaCamera
from olt_generator.lenses.kannala_brandt import KannalaBrandtCamera
from olt_generator.lenses.pinhole import PinholeCamera
from olt_generator.lenses.remap import remap_table

__all__ = [
    "BrownConradyCamera",
    "Camera",
    "FthetaCamera",
    "KannalaBrandtCamera",
    "Mask",
    "PinholeCamera",
    "fit_camera",
    "pixel_rays",
    "remap_table",
]
