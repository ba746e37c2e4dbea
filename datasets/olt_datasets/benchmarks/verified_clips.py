"""Small clips that nothing is wrong with: motion of hard drives with the noise of real ones, and plain moving images.

Nothing is rendered. What images show is no matter to checks of files, clocks and motion, but they change while the
vehicle moves, as real ones do.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from olt_closed_loop.hard_clips.kinds import specify_clip
from olt_closed_loop.hard_clips.staging import stage_scene
from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_generator.poses import Array
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import CameraStream, Clip, ClipOrigin, EgoMotion, ViewProvenance, make_clip_id
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, POLICY_CAMERAS
from olt_toolkit.rigs.rig_files import pav_rig

MOTIONS = ("turn", "stop_and_go", "hills", "traffic", "reverse", "standstill", "mixture", *CATEGORIES)
"""Drives of `hard_clips` by kind, and of scenes by category; they are taken in turn."""

_WIDTH, _HEIGHT = 64, 36
_RATES = (10.0, 12.5, 20.0, 30.0)  # poses a second; images are at 10 Hz
_POSITION_NOISE, _ANGLE_NOISE, _NOISE_SECONDS = 0.03, 2e-3, 0.5  # of GPS/IMU and LiDAR odometry: m, rad, smooth over s


def write_clean_store(root: Path, number: int, seed: int) -> ClipStore:
    """A store of two clips: the one of that number, and another of the same length of time or longer."""
    store = ClipStore(root)
    clips = [make_clean_clip(each, seed) for each in (2 * number, 2 * number + 1)]
    for clip in clips:
        store.prepare(clip)
    store.commit([clip.clip_id for clip in clips])
    return store


def make_clean_clip(number: int, seed: int) -> Clip:
    """The clip of that number; each depends on number and seed alone."""
    kind = MOTIONS[(number // 2) % len(MOTIONS)]
    generator = make_generator("verified clips", seed, number)
    motion = EgoMotion.from_trajectory(_noisy(_drive(kind, number, seed), generator))
    image_us = np.arange(0, motion.span_us[1], 100_000, dtype=np.int64)
    rig = pav_rig().fitted(_WIDTH, _HEIGHT)
    driven = _driven(motion, image_us)
    streams = {
        camera: CameraStream(_images(driven, generator), image_us, 10.0, rig[camera].camera, rig[camera].T_rig_camera)
        for camera in POLICY_CAMERAS
    }
    name = f"{kind}_{number:04d}"
    return Clip(
        clip_id=make_clip_id("verified clips", seed, number),
        name=name,
        scene_id=name,
        source="synthetic",
        origin=ClipOrigin(name, 0, int(image_us[-1])),
        kind="GT",
        category="nominal",
        factors=(),
        split="train",
        streams=streams,
        ego_motion=motion,
        vehicle=DEFAULT_VEHICLE,
        provenance={camera: ViewProvenance("rendered", "test", "1", None, 1.0, 0.0) for camera in streams},
    )


def _drive(kind: str, number: int, seed: int) -> Trajectory:
    if kind in CATEGORIES:
        return generate_scene(kind, 1_000_000 * seed + number).ego
    return stage_scene(specify_clip(kind, number, seed)).ego


def _noisy(drive: Trajectory, generator: np.random.Generator) -> Trajectory:
    """The drive at one of the rates of sensors, from time 0 on, with noise that is smooth in time."""
    rate = float(generator.choice(_RATES))
    seconds = min(float(drive.times[-1] - drive.times[0]), 12.0)
    times_us = np.round(np.arange(int(seconds * rate) + 1) * (1e6 / rate)).astype(np.int64)
    poses = drive.interpolate(times_us + drive.timestamps_us[0]).copy()
    count, smooth = len(times_us), _NOISE_SECONDS * rate
    noise = gaussian_filter1d(generator.normal(size=(count, 6)), smooth, axis=0)
    noise /= max(float(noise.std()), 1e-9)
    poses[:, :3, 3] += _POSITION_NOISE * noise[:, :3] * [1.0, 1.0, 0.5]
    poses[:, :3, :3] = Rotation.from_rotvec(_ANGLE_NOISE * noise[:, 3:]).as_matrix() @ poses[:, :3, :3]
    return Trajectory(times_us, poses)


def _driven(motion: EgoMotion, image_us: NDArray[np.int64]) -> Array:
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(motion.trajectory.positions, axis=0), axis=1))])
    return np.interp(image_us, motion.trajectory.timestamps_us, way)


def _images(driven: Array, generator: np.random.Generator) -> NDArray[np.uint8]:
    """A strip of texture (n, H, W, 3) that moves by 4 pixels a metre, with some noise of an imager."""
    strip = gaussian_filter1d(generator.normal(size=(_HEIGHT, 4 * int(driven[-1] + 2) + 2 * _WIDTH)), 1.5, axis=1)
    strip = np.clip(128.0 + 60.0 * strip / strip.std(), 0.0, 255.0)
    columns = 4.0 * driven[:, None] + np.arange(_WIDTH)
    place = np.arange(strip.shape[1])
    frames = np.stack([np.interp(columns, place, row) for row in strip], axis=1)
    frames = frames + generator.normal(scale=2.0, size=frames.shape)
    return np.repeat(np.clip(frames, 0.0, 255.0).astype(np.uint8)[..., None], 3, axis=-1)
