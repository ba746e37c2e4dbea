"""Which sources of motion and distance a clip is built with: names and paths, that can be sent to other processes."""

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from olt_generator.errors import InputError

if TYPE_CHECKING:
    from olt_generator.distance.depth_source import DepthSource
    from olt_generator.motion.pose_sources import PoseSource
    from olt_toolkit.clips.views import BuildOptions


class PoseChoice(StrEnum):
    """Where the motion of the vehicle comes from."""

    ODOMETRY = "odometry"
    REFERENCE = "reference"
    MAPANYTHING = "mapanything"


class DepthChoice(StrEnum):
    """Where the distances come from."""

    GEOMETRIC = "geometric"
    DEPTHANYTHING = "depthanything"
    DEPTHCRAFTER = "depthcrafter"


@dataclass(frozen=True)
class SourceChoice:
    """Sources by name.

    Attributes:
        poses: what measures the motion; the reference is taken as the recording has it.
        mapanything_weights: folder of MapAnything, for that source only.
        depth: what measures the distances.
        depth_weights: folder of the depth network, for the learned sources only.
        device: where torch runs the networks.

    Raises:
        InputError: weights are given without their source, or the other way round.
    """

    poses: PoseChoice = PoseChoice.ODOMETRY
    mapanything_weights: Path | None = None
    depth: DepthChoice = DepthChoice.GEOMETRIC
    depth_weights: Path | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        if (self.poses is PoseChoice.MAPANYTHING) != (self.mapanything_weights is not None):
            raise InputError("--poses mapanything and --mapanything-weights belong together; give both or neither")
        if (self.depth is DepthChoice.GEOMETRIC) != (self.depth_weights is None):
            raise InputError("--depth-weights belongs to --depth depthanything or depthcrafter; give both or neither")

    def apply(self, options: "BuildOptions") -> "BuildOptions":
        """The options with these sources.

        Raises:
            InputError: weights are missing or those of another network.
        """
        reference = options.use_reference_motion or self.poses is PoseChoice.REFERENCE
        return replace(options, use_reference_motion=reference, poses=_open_poses(self), depth=_open_depth(self))


def _open_poses(choice: SourceChoice) -> "PoseSource":
    if choice.mapanything_weights is None:
        from olt_generator.motion.pose_sources import VisualOdometry

        return VisualOdometry()
    from olt_generator.motion.map_anything import MapAnything

    return MapAnything(choice.mapanything_weights, choice.device)


@lru_cache(maxsize=1)  # a process builds many clips with one network
def _open_depth(choice: SourceChoice) -> "DepthSource":
    if choice.depth_weights is None:
        from olt_generator.distance.depth_source import GeometricDepth

        return GeometricDepth()
    if choice.depth is DepthChoice.DEPTHANYTHING:
        from olt_generator.distance.depth_anything import DepthAnything

        return DepthAnything(choice.depth_weights, choice.device)
    from olt_generator.distance.depth_crafter import DepthCrafter

    return DepthCrafter(choice.depth_weights, choice.device)
