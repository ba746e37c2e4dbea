"""Which estimators of motion and distance a clip is built with: names and paths, that can be sent to processes."""

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from olt_generator.errors import InputError

if TYPE_CHECKING:
    from olt_generator.distance.depth_source import DepthSource
    from olt_toolkit.clips.views import BuildOptions


class PoseEstimator(StrEnum):
    """Where the motion of the vehicle comes from; the reference is taken as the recording has it."""

    ODOMETRY = "odometry"
    REFERENCE = "reference"
    MAPANYTHING = "mapanything"


class DepthEstimator(StrEnum):
    """Where the distances come from."""

    GEOMETRIC = "geometric"
    DEPTHANYTHING = "depthanything"
    DEPTHCRAFTER = "depthcrafter"


@dataclass(frozen=True)
class Estimators:
    """Estimators by name, with the folders of the networks and the device on which torch runs them.

    Raises:
        InputError: weights are given without their estimator, or the other way round.
    """

    poses: PoseEstimator = PoseEstimator.ODOMETRY
    mapanything_weights: Path | None = None
    depth: DepthEstimator = DepthEstimator.GEOMETRIC
    depth_weights: Path | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        if (self.poses is PoseEstimator.MAPANYTHING) != (self.mapanything_weights is not None):
            raise InputError("--poses mapanything and --mapanything-weights belong together; give both or neither")
        if (self.depth is DepthEstimator.GEOMETRIC) != (self.depth_weights is None):
            raise InputError("--depth-weights belongs to --depth depthanything or depthcrafter; give both or neither")

        if self.device != "cpu" and self.mapanything_weights is None and self.depth_weights is None:
            raise InputError(f"--device {self.device}: no learned model is run; leave it out, or give one's weights")

    def apply(self, options: "BuildOptions") -> "BuildOptions":
        """The options with these estimators; an `InputError` where weights are missing or those of another network."""
        from olt_generator.motion.map_anything import MapAnything
        from olt_generator.motion.odometry import estimate_odometry

        weights = self.mapanything_weights
        poses = estimate_odometry if weights is None else MapAnything(weights, self.device)
        reference = options.use_reference_motion or self.poses is PoseEstimator.REFERENCE
        return replace(options, use_reference_motion=reference, poses=poses, depth=_open_depth(self))


@lru_cache(maxsize=1)  # a process builds many clips with one network
def _open_depth(estimators: Estimators) -> "DepthSource":
    if estimators.depth_weights is None:
        from olt_generator.distance.depth import estimate_distance

        return estimate_distance
    if estimators.depth is DepthEstimator.DEPTHANYTHING:
        from olt_generator.distance.depth_anything import DepthAnything

        return DepthAnything(estimators.depth_weights, estimators.device)
    from olt_generator.distance.depth_crafter import DepthCrafter

    return DepthCrafter(estimators.depth_weights, estimators.device)
