"""A clip: four camera streams and the ego motion of one drive, with where every pixel came from.

Clip time is integer microseconds; 0 is the start of the recording. The anchor frame is the rig at clip time 0 with its
roll and pitch taken out: origin there, yaw 0 there, z up. It is the frame of PhysicalAI-AV ego motion
(docs/formats/physicalai_av.md).
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.poses import Array, invert, make_pose, planar_pose, yaw_of
from olt_generator.trajectory import Trajectory
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.policy.contract import HISTORY_STEPS
from olt_toolkit.policy.window import FUTURE_OFFSETS_US, HISTORY_OFFSETS_US
from olt_toolkit.recordings.labels import Split
from olt_toolkit.recordings.truth import Holds, ObstacleTracks
from olt_toolkit.rigs.rig import VehicleDimensions

ClipKind = Literal["GT", "Syn", "front_only"]
"""GT: every view is a true image. Syn: some views are synthesized. front_only: the front views and nothing else."""

ViewKind = Literal["observed", "cropped", "mosaic", "rendered", "warped", "generated"]
"""How the images of a view came to be; a mosaic is put together from several cameras, and black where none saw."""

NoiseBasis = Literal["stated", "estimated"]
"""Where the noise of labels is from: the source of the motion states it, or it was estimated from the motion."""

# Below this speed (m/s) a curvature is a ratio of two noises; a standing vehicle is given curvature 0.
STANDSTILL_SPEED = 0.3

_CLIP_NAMESPACE = uuid.UUID("6f1c2c5e-3d0e-5b52-9a55-4f3c0f8f6f0a")


@dataclass(frozen=True)
class CameraStream:
    """The images of one camera over a clip.

    Attributes:
        frames: (n, H, W, 3) uint8 RGB.
        timestamps_us: (n,) int64 clip times, strictly increasing.
        frame_rate: nominal frames per second, written into the video file; times come from `timestamps_us` alone.
        camera: lens model at the size of `frames`; the store holds it as f-theta polynomials.
        T_rig_camera: (4, 4) mounting.
        origin: (n, H, W) uint8, a `PixelOrigin` per pixel; None where a camera saw all of them in their own frame.
    """

    frames: NDArray[np.uint8]
    timestamps_us: NDArray[np.int64]
    frame_rate: float
    camera: Camera
    T_rig_camera: Array
    origin: NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class EgoMotion:
    """The motion of the rig in the clip's anchor frame.

    Attributes:
        trajectory: rig poses over clip time; `T_world_rig` is the pose in the anchor frame.
        velocity: (n, 3) m/s in the anchor frame.
        acceleration: (n, 3) m/s^2 in the anchor frame.
        curvature: (n,) yaw rate over speed in 1/m, positive to the left.
    """

    trajectory: Trajectory
    velocity: Array
    acceleration: Array
    curvature: Array

    @classmethod
    def anchored(cls, trajectory: Trajectory, velocity: Array, acceleration: Array, curvature: Array) -> "EgoMotion":
        """Take a motion from any frame whose z is up to the anchor frame of its clip.

        Velocity (n, 3) m/s and acceleration (n, 3) m/s^2 are turned; curvature (n,) 1/m stays.

        Raises:
            InputError: the trajectory does not cover clip time 0.
        """
        start = trajectory.interpolate(np.zeros(1, np.int64))[0]
        T_anchor_world = invert(planar_pose(start[0, 3], start[1, 3], yaw_of(start), start[2, 3]))
        R_anchor_world = T_anchor_world[:3, :3]
        return cls(
            Trajectory(trajectory.timestamps_us, T_anchor_world @ trajectory.T_world_rig),
            velocity @ R_anchor_world.T,
            acceleration @ R_anchor_world.T,
            curvature,
        )

    @classmethod
    def from_trajectory(cls, trajectory: Trajectory) -> "EgoMotion":
        """The motion along measured poses, with derivatives of the cubic spline through them."""
        spline = CubicSpline(trajectory.times, trajectory.positions)
        velocity, acceleration = spline(trajectory.times, 1), spline(trajectory.times, 2)
        yaw_rate = CubicSpline(trajectory.times, np.unwrap(yaw_of(trajectory.T_world_rig)))(trajectory.times, 1)
        speed = np.linalg.norm(velocity, axis=1)
        curvature = np.where(speed > STANDSTILL_SPEED, yaw_rate / np.maximum(speed, STANDSTILL_SPEED), 0.0)
        return cls.anchored(trajectory, velocity, acceleration, curvature)

    @property
    def span_us(self) -> tuple[int, int]:
        """First and last clip time."""
        return int(self.trajectory.timestamps_us[0]), int(self.trajectory.timestamps_us[-1])

    def interpolate(self, timestamps_us: NDArray[np.int64]) -> Array:
        """Rig poses (m, 4, 4) in the anchor frame: spherical in rotation, cubic spline in position.

        This is the interpolation of the public PhysicalAI-AV reader, so that both give the same training poses.

        Raises:
            InputError: a time lies outside the motion.
        """
        first, last = self.span_us
        if timestamps_us.min() < first or timestamps_us.max() > last:
            raise InputError(
                f"ego motion covers {first} to {last} us; {int(timestamps_us.min())} to {int(timestamps_us.max())} us "
                "was asked for"
            )
        rotations, positions = self._curves
        query = timestamps_us - first
        return make_pose(rotations(query).as_matrix(), positions(query))

    @cached_property
    def _curves(self) -> tuple[Slerp, CubicSpline]:
        """Rotation and position over microseconds since the first pose."""
        known = self.trajectory.timestamps_us - self.trajectory.timestamps_us[0]
        rotations = Rotation.from_matrix(self.trajectory.T_world_rig[:, :3, :3])
        return Slerp(known, rotations), CubicSpline(known, self.trajectory.positions)

    def around(self, t0_us: NDArray[np.int64]) -> tuple[Array, Array]:
        """Past poses (m, 16, 4, 4) and future poses (m, 64, 4, 4) in the rig frame at each of the times t0 (m,).

        Raises:
            InputError: a pose lies outside the motion.
        """
        times_us = t0_us[:, None] + np.concatenate([HISTORY_OFFSETS_US, FUTURE_OFFSETS_US])
        poses = self.interpolate(times_us.ravel()).reshape(*times_us.shape, 4, 4)
        relative = invert(poses[:, HISTORY_STEPS - 1, None]) @ poses
        return relative[:, :HISTORY_STEPS], relative[:, HISTORY_STEPS:]


@dataclass(frozen=True)
class ViewProvenance:
    """Where the pixels of one view came from.

    Attributes:
        engine, version: what made the images.
        seed: of whatever was random; None where nothing was.
        observed_share, invented_share: shares of pixels, 0 to 1, that the vehicle's cameras saw, and that are made up.
        other_times_share: the part of `observed_share` that the front camera saw at other times than the image's.
    """

    kind: ViewKind
    engine: str
    version: str
    seed: int | None
    observed_share: float
    invented_share: float
    other_times_share: float = 0.0

    @property
    def unseen_share(self) -> float:
        """Share of pixels that are black because no camera looked there."""
        return max(0.0, round(1.0 - self.observed_share - self.invented_share, 12))

    @property
    def is_seen_whole(self) -> bool:
        """Whether a camera saw every pixel in its own frame; the clip then holds no mask of the view."""
        return self.observed_share == 1.0 and self.other_times_share == 0.0

    def with_shares(self, origin: NDArray[np.uint8]) -> "ViewProvenance":
        """The same with the shares of pixels (n, H, W), each a `PixelOrigin`."""
        counts = np.bincount(origin.ravel(), minlength=len(PixelOrigin)) / origin.size
        return replace(self, **shares_of(counts))


def shares_of(counts: NDArray[np.float64]) -> dict[str, float]:
    """The shares of `ViewProvenance`, of the share (4,) that each `PixelOrigin` has."""
    other = float(counts[PixelOrigin.OTHER_FRAME])
    return {
        "observed_share": float(counts[PixelOrigin.SAME_FRAME]) + other,
        "invented_share": float(counts[PixelOrigin.INVENTED]),
        "other_times_share": other,
    }


@dataclass(frozen=True)
class ClipOrigin:
    """What a clip was cut from, and when; two clips of one scene show the same where these times overlap.

    Attributes:
        recording: key of the drive in its data set; the recording's name where it is a single file.
        start_us, end_us: times of the first and the last front image, counted from the start of the scene.
        country, licence: ISO 3166 code of two letters, and name of the licence; None where not told.
    """

    recording: str
    start_us: int
    end_us: int
    country: str | None = None
    licence: str | None = None


@dataclass(frozen=True, kw_only=True)
class ClipDescription:
    """What a clip is, in memory as in the clip table.

    Attributes:
        clip_id: UUID text (`make_clip_id`).
        name: what people call the clip; two clips may have one name.
        scene_id: the scene it shows (`Drive.scene_id`); clips of one scene belong in one split.
        source: the reader of the recording.
        category, factors: long-tail category, "nominal", or `UNLABELLED`; the scene factors that hold.
        split: training split; None for a clip that is only indexed and that no rule has put into a split yet.
        doubts: what of the clip is in doubt, by name (`Doubt.what`); None where it is only indexed, so that nobody
            looked.
        scale_sigma: relative standard deviation of the metric scale of a recovered motion; None where the motion was
            given, or its scale is not known.
        acceleration_noise: m/s2 by which the acceleration labels are expected to err, root mean square; None where it
            was not measured, as in motion that is too short for a label.
        acceleration_noise_basis: where that number is from; None where there is none.
    """

    clip_id: str
    name: str
    scene_id: str
    source: str
    origin: ClipOrigin
    kind: ClipKind
    category: str
    factors: tuple[str, ...]
    split: Split | None
    doubts: tuple[str, ...] | None = None
    scale_sigma: float | None = None
    acceleration_noise: float | None = None
    acceleration_noise_basis: NoiseBasis | None = None


@dataclass(frozen=True, kw_only=True)
class Clip(ClipDescription):
    """One clip, ready to be stored; its streams, and where they came from, by camera name.

    `sample_t0_us` are the only times t0 at which it may be sampled, such as those before a crash; None for all times
    that it covers. `build_options` are those of `ClipInfo`. The `route` (n, 2) and the `road` (k, 4) are in the anchor
    frame, times of `obstacles` and `holds` are clip times; None where the source does not know them (`Recording`).
    """

    streams: dict[str, CameraStream]
    ego_motion: EgoMotion
    vehicle: VehicleDimensions
    provenance: dict[str, ViewProvenance]
    sample_t0_us: tuple[int, ...] | None = None
    build_options: str | None = None
    route: Array | None = None
    obstacles: ObstacleTracks | None = None
    holds: Holds | None = None
    road: Array | None = None

    @property
    def images(self) -> dict[str, NDArray[np.uint8]]:
        """Images (n, H, W, 3) by camera."""
        return {camera: stream.frames for camera, stream in self.streams.items()}

    @property
    def origins(self) -> dict[str, NDArray[np.uint8]]:
        """A `PixelOrigin` per pixel (n, H, W) by camera, of those that were not seen whole."""
        return {camera: stream.origin for camera, stream in self.streams.items() if stream.origin is not None}


@dataclass(frozen=True, kw_only=True)
class ClipInfo(ClipDescription):
    """One row of the clip table: everything that choosing clips needs, without opening one.

    Attributes:
        duration_us: clip time of the last ego pose.
        sample_t0_us: times t0, on a grid of 0.1 s, at which the clip gives a policy sample.
        no_sample_reason: why there is no such time; None where there is one.
        created_with: the code that wrote the clip (`runtime.version.code_version`).
        checksum: BLAKE2b (16 bytes, hexadecimal) of what the clip is made from: of `file_checksums` where it is stored,
            of the description and the window of its drive where it is only indexed.
        fingerprint: what the front images look like (`clips.fingerprint`); None where none was decoded.
        action_errors: for each of `sample_t0_us`, the mean distance (m) of its future from what the policy's action
            space can express; None where the motion is not known yet.
        build_options: how the clip was built, as JSON (`clips.build_options`); None where it is only indexed, or where
            whoever built it did not tell.
        file_checksums: those of its files by name (`clips.checksums`); None where it is only indexed.
    """

    duration_us: int
    sample_t0_us: tuple[int, ...]
    no_sample_reason: str | None
    created_with: str
    checksum: str
    fingerprint: bytes | None
    views: dict[str, ViewProvenance]
    action_errors: tuple[float, ...] | None = None
    build_options: str | None = None
    file_checksums: dict[str, str] | None = None

    def with_samples(self, t0s_us: Sequence[int]) -> "ClipInfo":
        """The same with some of its sample times alone, in their order."""
        kept = [place for place, time in enumerate(self.sample_t0_us) if time in t0s_us]
        errors = None if self.action_errors is None else tuple(self.action_errors[place] for place in kept)
        return replace(self, sample_t0_us=tuple(self.sample_t0_us[place] for place in kept), action_errors=errors)


def make_clip_id(*keys: int | str) -> str:
    """The UUID (version 5) of a clip; the same keys give the same one everywhere."""
    return str(uuid.uuid5(_CLIP_NAMESPACE, "\x1f".join(f"{type(key).__name__}:{key}" for key in keys)))


def check_clip_id(clip_id: object, where: str) -> str:
    """The clip id as lower-case UUID text; an `InputError` where it is anything else."""
    try:
        if isinstance(clip_id, str) and str(uuid.UUID(clip_id)) == clip_id:
            return clip_id
    except ValueError:
        pass
    raise InputError(f"{where}: clip id {clip_id!r} is not a UUID in lower case (8-4-4-4-12 hexadecimal digits)")
