"""Camera models, one a module, gathered under one name; conventions of pixels and axes: `lenses.camera_model`."""

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
