"""What a source knows of the world around the vehicle: boxes of others, and whether the way is held.

For auxiliary losses; policies are not shown it. Few sources know any of it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array

OBSTACLE_CLASSES: tuple[str, ...] = (
    "automobile",
    "heavy_truck",
    "bus",
    "train_or_tram_car",
    "trolley_bus",
    "other_vehicle",
    "trailer",
    "person",
    "stroller",
    "rider",
    "animal",
    "protruding_object",
    "cone",
    "barrier",
    "arm",
    "sign_stop",
    "sign_go",
    "other",
)
"""Classes of obstacles: those of PhysicalAI-AV (docs/formats/physicalai_av.md), then those of the synthetic world."""


@dataclass(frozen=True)
class ObstacleTracks:
    """Boxes of others at times, a row each.

    Attributes:
        timestamps_us: (r,) int64 times of the recording or clip.
        track_ids, labels: (r,) text: who it is, and of which class.
        boxes: (r, 7) float64: x, y, z of the centre in metres, yaw in radians, and length, width, height in metres, in
            the rig frame at that time.
    """

    timestamps_us: NDArray[np.int64]
    track_ids: NDArray[np.str_]
    labels: NDArray[np.str_]
    boxes: Array


@dataclass(frozen=True)
class Holds:
    """Whether the way is held, by a red light or somebody's hand.

    Attributes:
        timestamps_us: (k,) int64 times of the recording or clip, increasing.
        is_held: (k,) bool.
        distance: (k,) metres from the vehicle's front to the next line ahead on the route that is held at this or at
            another time, at most 80; NaN where there is none.
    """

    timestamps_us: NDArray[np.int64]
    is_held: NDArray[np.bool_]
    distance: Array
