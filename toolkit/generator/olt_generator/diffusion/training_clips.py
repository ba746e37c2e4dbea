"""What a training sample is made of: the true views of a clip, and what the geometric engine makes of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from olt_generator.cameras import Camera
from olt_generator.diffusion.geometry_encoder import ego_motion_features
from olt_generator.diffusion.latents import LatentCodec
from olt_generator.diffusion.rectified import latent_steps, rectified_camera
from olt_generator.diffusion.view_graph import VIEWS
from olt_generator.diffusion.warp_control import cell_visibility, warp_prior
from olt_generator.errors import InputError
from olt_generator.lenses.remap import Remapper
from olt_generator.poses import Array
from olt_generator.views.front_view import FrontView
from olt_generator.views.lookback import LOOKBACK_LATENTS
from olt_generator.views.plucker import anchor_poses, plucker_rays
from olt_generator.views.synthesis import SynthesisSettings, synthesize_view

Video = NDArray[np.uint8]

# Encoded at once: small videos take as long one by one as some together, large ones need the memory.
_MOST_PIXELS = 500_000


@dataclass(frozen=True)
class TrueView:
    """Images (n, H, W, 3) uint8 that a camera at the mounting (4, 4) really took."""

    images: Video
    camera: Camera
    T_rig_camera: Array


@dataclass(frozen=True)
class ClipVideos:
    """All six views of a clip by view id, straight-lined.

    Attributes:
        truth: (6, f, h, w, 3) uint8.
        filled: (6, f, h, w, 3) uint8 of the geometric engine; view 0 is the truth.
        origin: (6, f, h, w) uint8, a `PixelOrigin` per pixel of `filled`.
        known: (6, h, w) bool, pixels that the real lens shows; others count nowhere. There the truth is `filled`, and
            black in view 0.
        rays: (6, 6, t, h / 16, w / 16) float32 of `plucker_rays`.
        motion: (t, 6) float32 of `ego_motion_features`.
        lenses: (6, 4) float64, fx, fy, cx, cy of the pinholes in pixels.
        poses: (6, f, 4, 4) float64, T_anchor_camera of every frame; the anchor is the front camera at the first.
    """

    truth: Video
    filled: Video
    origin: Video
    known: NDArray[np.bool_]
    rays: NDArray[np.float32]
    motion: NDArray[np.float32]
    lenses: Array
    poses: Array


@dataclass(frozen=True)
class TrainingClip:
    """The same as the network takes it.

    Attributes:
        latents, warped: (6, 16, t, h, w) normalised latents of the truth, and of what was warped (view 0: zeros).
        visibility: (6, 1, t, h, w) 0 to 1.
        rays, motion: see `ClipVideos`.
    """

    latents: Tensor
    warped: Tensor
    visibility: Tensor
    rays: Tensor
    motion: Tensor


def make_videos(
    front: FrontView, views: Mapping[str, TrueView], indices: Sequence[int], width: int, height: int
) -> ClipVideos:
    """Straight-line the true views of some frames of a drive, and make them again by the geometric engine.

    Args:
        front: the whole drive, so that the warp may draw on frames outside of the clip.
        views: the five views that are generated, by name, one image for each frame of `front`.
        indices: the frames of the clip, 4 k + 1.

    Raises:
        InputError: a view is missing, or the frames are not 4 k + 1.
    """
    missing = [name for name in VIEWS[1:] if name not in views]
    if missing:
        raise InputError(f"true views: {', '.join(missing)} missing; training takes drives with all six views")
    frames, steps = list(indices), latent_steps(len(indices))
    given = TrueView(front.frames, front.camera, front.T_rig_camera)
    truth, filled, origin, known, rays, lenses, all_poses = [], [], [], [], [], [], []
    T_world_front = front.camera_poses[frames]
    for view, name in enumerate(VIEWS):
        true = given if view == 0 else views[name]
        camera = rectified_camera(true.camera, width, height)
        remapper = Remapper(true.camera, camera, np.eye(3))
        truth.append(remapper.remap(true.images[frames]))
        known.append(np.asarray(remapper.seen))
        poses = anchor_poses(T_world_front, front.T_rig_camera, true.T_rig_camera)
        rays.append(plucker_rays(camera, poses[steps]))
        lenses.append([camera.fx, camera.fy, camera.cx, camera.cy])
        all_poses.append(poses)
        if view == 0:
            filled.append(truth[0])
            origin.append(np.ones(truth[0].shape[:3], np.uint8))
            continue
        settings = SynthesisSettings(lookback=LOOKBACK_LATENTS.get(name))
        made = synthesize_view(front, camera, true.T_rig_camera, frames, settings)
        # Beyond the real lens there is no truth; the geometric engine goes on without an edge to be learned.
        truth[view] = np.where(known[view][..., None], truth[view], made.images)
        filled.append(made.images)
        origin.append(made.origin)
    return ClipVideos(
        np.stack(truth),
        np.stack(filled),
        np.stack(origin),
        np.stack(known),
        np.stack(rays),
        ego_motion_features(all_poses[0][steps]),
        np.array(lenses),
        np.stack(all_poses),
    )


def warp_videos(videos: ClipVideos, fill: bool) -> list[tuple[Video, NDArray[np.float32]]]:
    """What `warp_prior` makes of each of the five views that are generated."""
    views = zip(videos.filled[1:], videos.origin[1:], strict=True)
    return [warp_prior(image, origin, fill) for image, origin in views]


def encode_clip(videos: ClipVideos, codec: LatentCodec, fill: bool) -> TrainingClip:
    """Encode true and warped videos; `fill` as of `warp_prior`."""
    warps = warp_videos(videos, fill)
    latents = _encode(videos.truth, codec)
    warped = _encode(np.stack([image for image, _ in warps]), codec)
    visibility = cell_visibility(torch.from_numpy(np.stack([visible for _, visible in warps])))
    return TrainingClip(
        latents,
        torch.cat([torch.zeros_like(warped[:1]), warped]),
        torch.cat([torch.zeros_like(visibility[:1]), visibility]),
        torch.from_numpy(videos.rays),
        torch.from_numpy(videos.motion),
    )


def _encode(videos: Video, codec: LatentCodec) -> Tensor:
    """Latents of videos (n, f, h, w, 3), together where they are small."""
    together = max(1, _MOST_PIXELS // math.prod(videos.shape[1:4]))
    return torch.cat([codec.encode(part) for part in torch.from_numpy(videos).split(together)])
