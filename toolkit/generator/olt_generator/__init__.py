"""The view engine: one front-camera video to an ego trajectory, distances, warps and the views of a target rig.

The package stands alone and imports nothing else of the project. The names in `__all__` are imported when they are
first asked for.
"""

from typing import TYPE_CHECKING

from olt_generator.lazy_names import lazy_names
from olt_generator.version import __version__ as __version__

if TYPE_CHECKING:
    from olt_generator.cameras import BrownConradyCamera, Camera, FthetaCamera, KannalaBrandtCamera, PinholeCamera
    from olt_generator.distance.depth import estimate_distance
    from olt_generator.errors import InputError
    from olt_generator.metrics.image_metrics import psnr, ssim
    from olt_generator.motion.focal_length import estimate_field_of_view
    from olt_generator.motion.odometry import estimate_odometry
    from olt_generator.motion.pose_metrics import compare_trajectories
    from olt_generator.motion.smoother import smooth_trajectory
    from olt_generator.poses import camera_pose_in_rig
    from olt_generator.trajectory import Trajectory
    from olt_generator.video import read_video, write_video
    from olt_generator.views.front_view import FrontView
    from olt_generator.views.moving_objects import check_distances, find_moving
    from olt_generator.views.synthesis import synthesize_view
    from olt_generator.views.tele import crop_tele, tele_camera

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "cameras": ("BrownConradyCamera", "Camera", "FthetaCamera", "KannalaBrandtCamera", "PinholeCamera"),
        "distance.depth": ("estimate_distance",),
        "errors": ("InputError",),
        "metrics.image_metrics": ("psnr", "ssim"),
        "motion.focal_length": ("estimate_field_of_view",),
        "motion.odometry": ("estimate_odometry",),
        "motion.pose_metrics": ("compare_trajectories",),
        "motion.smoother": ("smooth_trajectory",),
        "poses": ("camera_pose_in_rig",),
        "trajectory": ("Trajectory",),
        "video": ("read_video", "write_video"),
        "views.front_view": ("FrontView",),
        "views.moving_objects": ("check_distances", "find_moving"),
        "views.synthesis": ("synthesize_view",),
        "views.tele": ("crop_tele", "tele_camera"),
    },
)

__all__ = [
    "BrownConradyCamera",
    "Camera",
    "FrontView",
    "FthetaCamera",
    "InputError",
    "KannalaBrandtCamera",
    "PinholeCamera",
    "Trajectory",
    "camera_pose_in_rig",
    "check_distances",
    "compare_trajectories",
    "crop_tele",
    "estimate_distance",
    "estimate_field_of_view",
    "estimate_odometry",
    "find_moving",
    "psnr",
    "read_video",
    "smooth_trajectory",
    "ssim",
    "synthesize_view",
    "tele_camera",
    "write_video",
]
