"""Motion by MapAnything, a learned model of metric geometry from many images (Keetha et al., 3DV 2026).

The package `mapanything` and the weights are the user's to install (github.com/facebookresearch/map-anything); nothing
is downloaded. All frames enter at once, each with the ray of every pixel, so any lens will do. What comes back are
camera-to-world poses, x right, y down, z forward, to which the model's metric scale is already applied.
"""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.motion.pose_sources import PoseEstimate, rig_trajectory
from olt_generator.motion.smoother import SmootherSettings
from olt_generator.poses import Array, make_pose
from olt_generator.progress import Progress, silent

WEIGHT_FILES = ("config.json", "model.safetensors")


@dataclass(frozen=True)
class MapAnything:
    """A `PoseSource` that runs MapAnything.

    Attributes:
        weights: folder with the model's config.json and model.safetensors.
        device: where torch runs it.
    """

    weights: Path
    device: str = "cuda"

    def __call__(
        self,
        frames: NDArray[np.uint8],
        timestamps_us: NDArray[np.int64],
        camera: Camera,
        T_rig_camera: Array,
        on_progress: Progress = silent,
    ) -> PoseEstimate:
        """See `PoseSource`; also an `InputError` where package or weights are missing."""
        models, images = self._load_package()
        model = models.MapAnything.from_pretrained(str(self.weights), local_files_only=True).to(self.device).eval()
        on_progress(0.1)
        rays = torch.from_numpy(pixel_rays(camera).astype(np.float32))
        views = images.preprocess_inputs([{"img": torch.from_numpy(frame), "ray_directions": rays} for frame in frames])
        with torch.inference_mode():
            on_device = [
                {name: value.to(self.device) if hasattr(value, "to") else value for name, value in view.items()}
                for view in views
            ]
            amp = self.device != "cpu"
            predictions = model.infer(on_device, use_amp=amp, apply_mask=False, mask_edges=False)
        on_progress(1.0)
        trajectory = rig_trajectory(timestamps_us, _camera_poses(predictions), T_rig_camera)
        return PoseEstimate(trajectory, T_rig_camera, None, SmootherSettings())

    def _load_package(self) -> tuple[ModuleType, ModuleType]:
        """The modules of models and of images, once the weights are known to be there."""
        missing = [name for name in WEIGHT_FILES if not (self.weights / name).is_file()]
        if missing:
            raise InputError(
                f"{self.weights}: no {' and no '.join(missing)}; download facebook/map-anything or "
                "facebook/map-anything-apache from Hugging Face and give the folder"
            )
        try:
            return import_module("mapanything.models"), import_module("mapanything.utils.image")
        except ModuleNotFoundError as error:
            raise InputError(
                f"MapAnything: Python package {error.name} is not installed; install mapanything from "
                "github.com/facebookresearch/map-anything, or use visual odometry"
            ) from error


def _camera_poses(predictions: list[dict[str, Any]]) -> Array:
    """Camera-to-world poses (n, 4, 4), with the rounding of half precision taken out of the rotations."""
    scales = np.array([float(prediction["metric_scaling_factor"].float().mean()) for prediction in predictions])
    if not np.all(np.isfinite(scales) & (scales > 0.0)):
        frame = int(np.argmin(np.isfinite(scales) & (scales > 0.0)))
        raise InputError(f"MapAnything: no metric scale for frame {frame}; cut away dark, blurred or blank frames")
    poses = np.stack([prediction["camera_poses"][0].float().cpu().numpy() for prediction in predictions])
    if not np.all(np.isfinite(poses)):
        frame = int(np.argmin(np.isfinite(poses).all(axis=(1, 2))))
        raise InputError(f"MapAnything: no pose for frame {frame}; cut away dark, blurred or blank frames")
    return make_pose(Rotation.from_matrix(poses[:, :3, :3]).as_matrix(), poses[:, :3, 3])
