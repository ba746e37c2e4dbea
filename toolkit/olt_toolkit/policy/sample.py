"""One training sample of a driving policy, in the names and shapes of the public Alpamayo loader."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

KEYFRAME_US = 5_100_000
"""The time t0 at which the public loader samples a clip that has no events (docs/formats/physicalai_av.md)."""

TRUTH_OFFSETS_US = (0, 1_000_000, 2_000_000, 3_000_000, 4_000_000)
"""Times after t0 at which samples tell where obstacles are."""
MOST_OBSTACLES = 32
"""Obstacles that a sample tells of: those nearest at t0."""


@dataclass(frozen=True, order=True)
class SampleKey:
    """Where a sample is found: the folder of its clip store, the clip, and the time t0 in microseconds of clip time."""

    store: str
    clip_id: str
    t0_us: int


@dataclass(frozen=True)
class PolicySample:
    """One sample (docs/formats/physicalai_av.md), poses in the rig frame at t0.

    Attributes:
        image_frames: (cameras, 4, 3, H, W) uint8 RGB: cameras by index, then frames by time.
        camera_indices: (cameras,) int64, those of the camera contract: [0, 1, 2, 6] or [0, 1, 2, 3, 5, 6].
        ego_history_xyz: (1, 16, 3) float32 at t0 - 1.5 ... 0 s; ego_history_rot: (1, 16, 3, 3) float32.
        ego_future_xyz: (1, 64, 3) float32 at t0 + 0.1 ... 6.4 s; ego_future_rot: (1, 64, 3, 3) float32.
        relative_timestamps: (cameras, 4) float32 seconds from the earliest frame.
        absolute_timestamps: (cameras, 4) int64 microseconds of the frames.
        t0_us, clip_id: which sample it is.
        image_origin: (cameras, 4, H, W) uint8, a `PixelOrigin` for each pixel; None where it was not asked for. The
            public loader has no such field, nor the following.
        route_xy: (20, 2) float32 points ahead on the route, as `Observation.route_xy` of the closed loop gives them;
            NaN where the route ends earlier or is not known.
        obstacle_boxes: (5, 32, 5) float32 x, y of the centre in metres, yaw, length and width of the nearest obstacles
            at TRUTH_OFFSETS_US, each in its place at all times; NaN where nobody is or nothing is known.
        obstacle_classes: (32,) int64 numbers of `recordings.truth.OBSTACLE_CLASSES`, -1 where there is none.
        hold: (2,) float32: whether the way is held (1 or 0), and metres to the line that is or will be held; NaN where
            there is none, or nothing is known.
        road: (20, 4) float32 x, y of points ahead on the route, and metres of road to the right and left of each; NaN
            where the route ends or nothing is known. These four are None where they were not asked for.
    """

    image_frames: NDArray[np.uint8]
    camera_indices: NDArray[np.int64]
    ego_history_xyz: NDArray[np.float32]
    ego_history_rot: NDArray[np.float32]
    ego_future_xyz: NDArray[np.float32]
    ego_future_rot: NDArray[np.float32]
    relative_timestamps: NDArray[np.float32]
    absolute_timestamps: NDArray[np.int64]
    t0_us: int
    clip_id: str
    image_origin: NDArray[np.uint8] | None = None
    route_xy: NDArray[np.float32] | None = None
    obstacle_boxes: NDArray[np.float32] | None = None
    obstacle_classes: NDArray[np.int64] | None = None
    hold: NDArray[np.float32] | None = None
    road: NDArray[np.float32] | None = None
