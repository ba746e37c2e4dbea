"""What the images of all cameras of a clip say of it, gathered once for all checks that look at them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from olt_generator.cameras import Camera
from olt_generator.poses import Array, planar_pose
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.calibration_checks import field_of_view
from olt_toolkit.clips.verification.decoded_videos import ClipVideos
from olt_toolkit.clips.verification.gains import STRETCHES, Gain, over_cameras, stretch_gains, sum_up
from olt_toolkit.clips.verification.hypotheses import motion_of
from olt_toolkit.clips.verification.image_evidence import AS_SAID, Hypothesis, ImageEvidence
from olt_toolkit.clips.verification.image_steps import CameraImages, follow_points, read_camera_images
from olt_toolkit.rigs.rig import MountedCamera

# Motions that are tried where none is believed: speeds (m/s) and yaw rates (rad/s).
SPEEDS: Array = np.array([-3.0, 0.0, 1.0, 2.5, 5.0, 8.0, 12.0, 17.0, 24.0, 34.0])
YAW_RATES: Array = np.array([-0.7, -0.5, -0.35, -0.24, -0.16, -0.1, -0.05, 0.0, 0.05, 0.1, 0.16, 0.24, 0.35, 0.5, 0.7])
# Of the steps and of their points, only one in so many is held against each of these motions.
THINNED_STEPS, THINNED_POINTS = 2, 2
# Videos are held against the motions of so many other clips of the store.
OTHER_CLIPS = 8

# A camera with a narrower field of view, radians, may show nothing but the vehicle ahead, which turns and brakes with
# its own.
NARROW = float(np.radians(45.0))


def is_narrow(lens: Camera) -> bool:
    """Whether a vehicle ahead may fill the view."""
    return field_of_view(lens) < NARROW


@dataclass(frozen=True)
class ClipEvidence:
    """The cameras of a clip, their images, and the evidence of each; in the order of the clip table.

    `other_motions` are those of clips beside it in its store, by name. `agreeing` are the cameras that show what the
    ones beside them show where both look, at the same time: what moves in them otherwise than the vehicle is traffic.
    `accused` are those that show another thing than all that look there, too.
    """

    clip_id: str
    ego_motion: EgoMotion
    mounted: dict[str, MountedCamera]
    images: dict[str, CameraImages]
    evidence: dict[str, ImageEvidence]
    other_motions: dict[str, Hypothesis]
    agreeing: frozenset[str] = frozenset()
    accused: frozenset[str] = frozenset()

    @cached_property
    def said(self) -> dict[str, Array]:
        """Log-likelihood (n,) of the points, by camera, if the clip is what it says."""
        return {name: evidence.of(AS_SAID) for name, evidence in self.evidence.items()}

    @cached_property
    def way(self) -> float:
        """Metres that the vehicle drives, as the clip says, while the front images are taken."""
        return self.ego_motion.trajectory.path_length

    @cached_property
    def _known_gains(self) -> dict[tuple[str, Hypothesis], Array]:
        return {}

    def gains(self, camera: str, hypothesis: Hypothesis) -> Array:
        """Gains by stretch of a hypothesis about one camera; worked out once."""
        if (camera, hypothesis) not in self._known_gains:
            evidence = self.evidence[camera]
            found = stretch_gains(evidence.steps, self.said[camera], evidence.of(hypothesis))
            self._known_gains[camera, hypothesis] = found
        return self._known_gains[camera, hypothesis]

    def gain(self, camera: str, hypothesis: Hypothesis) -> Gain:
        """Gain of a hypothesis about one camera."""
        return sum_up(self.gains(camera, hypothesis))

    @cached_property
    def speed(self) -> float:
        """Mean speed in m/s, as the clip says."""
        first_us, last_us = self.ego_motion.span_us
        return self.way / (1e-6 * (last_us - first_us))

    @cached_property
    def wide(self) -> tuple[str, ...]:
        """The cameras that tell of the motion: one with a narrow view may show the vehicle ahead and nothing else."""
        return tuple(camera for camera, mounted in self.mounted.items() if not is_narrow(mounted.camera))

    def joint_gain(self, hypothesis: Hypothesis) -> Gain:
        """Gain of a hypothesis about the motion, over all wide cameras."""
        return sum_up(over_cameras([self.gains(camera, hypothesis) for camera in self.wide]))

    def joint_free_gain(self) -> Gain:
        """Gain of the best steady motions in each stretch, over all wide cameras."""
        return sum_up(over_cameras([self.free_gains(camera) for camera in self.wide]))

    def free_gains(self, camera: str) -> Array:
        """Gains by stretch of the best steady motion in each of them."""
        evidence = self.evidence[camera].thinned(THINNED_STEPS, THINNED_POINTS)
        steps, said = evidence.steps, evidence.of(AS_SAID)
        times_us = steps.images.times_us
        seconds = (times_us[steps.second] - times_us[steps.first]) * 1e-6
        best = np.full((STRETCHES, 4), -np.inf)
        for speed in SPEEDS:
            for yaw_rate in YAW_RATES:
                way = speed * seconds
                turned = yaw_rate * seconds
                motion = evidence.of_motion(planar_pose(way, 0.5 * turned * way, turned))
                gains = stretch_gains(steps, said, motion)
                best = np.where(gains[:, :1] > best[:, :1], gains, best)
        return np.where(np.isfinite(best[:, :1]), best, [np.nan, 0.0, np.nan, np.nan])


def gather_evidence(store: ClipStore, clip_id: str, cameras: Sequence[str], videos: ClipVideos) -> ClipEvidence:
    """Read the images of some cameras of a clip and follow points in them.

    Raises:
        InputError: the clip's files are damaged.
    """
    ego_motion = store.read_ego_motion(clip_id)
    images = {camera: read_camera_images(store, clip_id, camera, videos) for camera in cameras}
    return ClipEvidence(
        clip_id,
        ego_motion,
        {camera: store.read_camera(clip_id, camera) for camera in cameras},
        images,
        {camera: ImageEvidence(follow_points(seen), ego_motion) for camera, seen in images.items()},
        _read_other_motions(store, clip_id),
    )


def _read_other_motions(store: ClipStore, clip_id: str) -> dict[str, Hypothesis]:
    """The motions of the clips nearest in the clip table: videos are mixed up within one run of a program."""
    clips = store.clips()
    place = next(index for index, info in enumerate(clips) if info.clip_id == clip_id)
    first = max(0, min(place - OTHER_CLIPS // 2, len(clips) - 1 - OTHER_CLIPS))
    others = [info for info in clips[first : first + OTHER_CLIPS + 1] if info.clip_id != clip_id]
    return {info.name: motion_of(store.read_ego_motion(info.clip_id)) for info in others}
