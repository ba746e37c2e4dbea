"""Training samples in memory, and two ways to augment them.

A policy that has seen a few hundred moments of driving learns them by heart. Mirrored samples double what there is;
a perturbed sample shows what the road looks like from a little off the path, and how to get back.
"""

from dataclasses import dataclass, fields, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import pixel_rays
from olt_generator.poses import Array, invert, planar_pose, transform
from olt_generator.views.pixel_origin import PixelOrigin
from olt_sft_recipes.toy.config import ToyPolicyConfig
from olt_sft_recipes.toy.inputs import cells_along, pad_route, planar_poses, select_images
from olt_sft_recipes.training.auxiliary import gather_truth
from olt_toolkit.policy.action_space import estimate_initial_speed, trajectory_to_actions
from olt_toolkit.policy.sample import PolicySample
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, REAR_LEFT, REAR_RIGHT
from olt_toolkit.rigs.rig_files import pav_rig

# Cameras that change places in a mirror.
_MIRRORED = {CROSS_LEFT: CROSS_RIGHT, REAR_LEFT: REAR_RIGHT}
_MIRRORED |= {right: left for left, right in _MIRRORED.items()}
# Distance in metres over which a vehicle that is off its path has returned to it.
RETURN_METRES = 8.0
# Above the horizon the scene is taken to be this far away.
FAR_METRES = 200.0


@dataclass(frozen=True)
class DrivingSamples:
    """Samples of one size.

    Attributes:
        images: (n, cameras, frames, 3, rows, W) uint8, of `inputs.select_images`.
        history, future: (n, 16, 3) and (n, 64, 3) of x, y in metres and yaw in radians, in the rig frame at t0.
        routes: (n, 20, 2) route ahead in metres in the rig frame at t0, filled up with NaN.
        config: of the model that they are for.
        invented: (n,) share of the pixels of the images that is invented, at the size of the clip.
        truth_known: (n, 2) bool, whether it is known who is where and what is held, and where the road is.
        truth_route: (n, ...) uint8 of what is where (`auxiliary.SightTruth`).
    """

    images: NDArray[np.uint8]
    history: Array
    future: Array
    routes: Array
    config: ToyPolicyConfig
    invented: Array
    truth_known: NDArray[np.bool_]
    truth_route: NDArray[np.uint8]

    @classmethod
    def gather(cls, samples: list[PolicySample], config: ToyPolicyConfig) -> "DrivingSamples":
        """Take what the toy uses of loaded samples; its world is flat.

        Where samples do not tell where their pixels come from, nothing is taken to be invented.
        """
        origins = [sample.image_origin for sample in samples]
        invented = [
            0.0 if origin is None else float((origin[:, list(config.frames)] == PixelOrigin.INVENTED).mean())
            for origin in origins
        ]
        history = np.stack([planar_poses(sample.ego_history_xyz[0], sample.ego_history_rot[0]) for sample in samples])
        routes = np.stack([pad_route(sample.route_xy) for sample in samples])
        return cls(
            np.stack([select_images(sample.image_frames, config) for sample in samples]),
            history,
            np.stack([planar_poses(sample.ego_future_xyz[0], sample.ego_future_rot[0]) for sample in samples]),
            routes,
            config,
            np.array(invented),
            *gather_truth(samples, cells_along(history, routes)),
        )

    def __len__(self) -> int:
        return len(self.images)

    def take(self, rows: list[int] | slice) -> "DrivingSamples":
        """Some of the samples; those of a slice are not copied."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "config"}
        return replace(self, **{name: values[rows] for name, values in arrays.items()})

    def weights(self, invented_pixel_weight: float, rows: NDArray[np.int64] | slice = slice(None)) -> Array:
        """Weights (n,) of samples, all by default, where an invented pixel counts for so much of a seen one.

        w = 1 - (1 - `invented_pixel_weight`) * share of invented pixels.
        """
        return 1.0 - (1.0 - invented_pixel_weight) * self.invented[rows]

    def mirrored(self) -> "DrivingSamples":
        """The same drives in a world where left is right."""
        flip = np.array([1.0, -1.0, -1.0])
        names = self.config.camera_names
        order = [names.index(_MIRRORED.get(name, name)) for name in names]
        return replace(
            self,
            images=np.ascontiguousarray(self.images[:, order][..., ::-1]),
            history=self.history * flip,
            future=self.future * flip,
            routes=self.routes * flip[:2],
            truth_route=self.truth_route[..., ::-1],
        )

    def perturbed(self, offsets: Array, angles: Array) -> "DrivingSamples":
        """The same moments with the vehicle off its path, to which it then returns.

        The history is the vehicle's own and stays. With offset d and angle a the distance from the path after s metres
        is e(s) = (d + (a + d / L) s) exp(-s / L), so that e(0) = d and e'(0) = a. What is where is no longer known.

        Args:
            offsets: (n,) metres to the left.
            angles: (n,) small turns to the left in radians.
        """
        steps = np.diff(self.future[..., :2], axis=1, prepend=0.0)
        distance = np.cumsum(np.linalg.norm(steps, axis=-1), axis=1)
        slope, decay = (angles + offsets / RETURN_METRES)[:, None], np.exp(-distance / RETURN_METRES)
        off = (offsets[:, None] + slope * distance) * decay
        heading = slope * decay - off / RETURN_METRES
        x, y, yaw = np.moveaxis(self.future, -1, 0)
        x, y = _seen_from(x - off * np.sin(yaw), y + off * np.cos(yaw), offsets, angles)
        images = np.stack(
            [_perturb_images(self.config, *sample) for sample in zip(self.images, offsets, angles, strict=True)]
        )
        future = np.stack([x, y, yaw + heading - angles[:, None]], axis=-1)
        routes = np.stack(_seen_from(self.routes[..., 0], self.routes[..., 1], offsets, angles), axis=-1)
        return replace(self, images=images, future=future, routes=routes, truth_known=np.zeros_like(self.truth_known))

    def speeds(self) -> Array:
        """Speeds (n,) at t0 in m/s, from which `actions` are driven."""
        history = planar_pose(*np.moveaxis(self.history, -1, 0))
        return estimate_initial_speed(history[..., :3, 3], history[..., :3, :3])

    def actions(self) -> Array:
        """Normalised actions (n, 64, 2) that drive the futures."""
        history, future = (planar_pose(*np.moveaxis(planar, -1, 0)) for planar in (self.history, self.future))
        return trajectory_to_actions(history[..., :3, 3], history[..., :3, :3], future[..., :3, 3], future[..., :3, :3])


def _seen_from(x: Array, y: Array, offsets: Array, angles: Array) -> tuple[Array, Array]:
    """Points (n, k) as the vehicle sees them that is so far to the left and so turned."""
    y = y - offsets[:, None]
    cos, sin = np.cos(angles)[:, None], np.sin(angles)[:, None]
    return cos * x + sin * y, cos * y - sin * x


def _perturb_images(
    config: ToyPolicyConfig, images: NDArray[np.uint8], offset: float, angle: float
) -> NDArray[np.uint8]:
    """Images (cameras, frames, 3, rows, W) of one moment as the perturbed vehicle would see its road and sky."""
    perturbed, top = np.empty_like(images), config.image_top
    for camera, name in enumerate(config.camera_names):
        u, v = _road_tables(name, config.image_width, config.image_height, offset, angle)
        for frame in range(images.shape[1]):
            picture = cv2.remap(
                images[camera, frame].transpose(1, 2, 0),
                u[top:],
                v[top:] - top,
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            )
            perturbed[camera, frame] = picture.transpose(2, 0, 1)
    return perturbed


@lru_cache(maxsize=512)
def _road_tables(
    name: str, width: int, height: int, offset: float, angle: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Column and row, each (height, width), where a pixel of the perturbed camera is in the image that was taken.

    Exact for the road plane, and for what is far above the horizon; what stands on the road is moved with it.
    """
    mounted = pav_rig().fitted(width, height)[name]
    T_taken_perturbed = planar_pose(0.0, offset, angle)
    rays = pixel_rays(mounted.camera) @ mounted.T_rig_camera[:3, :3].T
    down = np.minimum(rays[..., 2:], -1e-3)
    reach = np.where(rays[..., 2:] < 0.0, -mounted.T_rig_camera[2, 3] / down, FAR_METRES)
    points = mounted.T_rig_camera[:3, 3] + np.minimum(reach, FAR_METRES) * rays
    points = transform(invert(mounted.T_rig_camera) @ T_taken_perturbed, points.reshape(-1, 3))
    pixels = mounted.camera.project(points)[0].reshape(height, width, 2).astype(np.float32)
    return pixels[..., 0].copy(), pixels[..., 1].copy()
