"""From a specification to a recording with its exact motion."""

import hashlib
from functools import lru_cache
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.hard_clips.specification import ClipSpecification, FilmingCamera
from olt_closed_loop.hard_clips.staging import LEAD_IN_SECONDS, stage_scene
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.sensors.camera_effects import Film
from olt_closed_loop.sensors.ray_casting import SceneRenderer
from olt_generator.cameras import Camera, FthetaCamera, PinholeCamera
from olt_generator.files import write_whole
from olt_generator.poses import Array, camera_pose_in_rig
from olt_generator.trajectory import Trajectory
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import MountedCamera

# Where the camera sits: metres ahead of the rear axle and to its left.
_FORWARD, _LEFT = 1.6, 0.0
# What decides over the frames of a clip: a file of a cache made by other code is not read.
_SOURCES = ("hard_clips", "scenes", "sensors")


def make_clip(specification: ClipSpecification, cache: Path | None = None) -> Recording:
    """Film a hard clip: the recording states the camera as the specification does, and is taken by the true one.

    Frames are kept in the folder `cache`, without loss, and read from there the next time.
    """
    scene, camera = stage_scene(specification), specification.camera
    elapsed_us = np.round(np.arange(specification.frames) * (1e6 / specification.frame_rate)).astype(np.int64)
    times_us = elapsed_us + round(LEAD_IN_SECONDS * 1e6)
    file = None if cache is None else cache / f"{specification.name}.{_digest(specification)}.mkv"
    if file is not None and file.is_file():
        frames = _read_frames(file)
    else:
        frames = _film(specification, scene, times_us)
        if file is not None:
            _write_frames(file, frames)
    return Recording(
        name=specification.name,
        source="synthetic",
        frames=frames,
        timestamps_us=elapsed_us,
        camera=_lens(camera, 0.0),
        T_rig_camera=_mount(camera, true=False),
        vehicle=scene.vehicle,
        reference=Trajectory(elapsed_us, scene.ego.interpolate(times_us)).in_first_frame(),
        spread=camera.spread,
    )


def _film(specification: ClipSpecification, scene: Scene, times_us: NDArray[np.int64]) -> NDArray[np.uint8]:
    camera = specification.camera
    mounted = MountedCamera(_lens(camera, camera.focal_off), _mount(camera, true=True))
    renderer = SceneRenderer(scene, specification.conditions)
    film = Film(renderer, mounted, specification.effects, specification.seed)
    for time_us in times_us.tolist():
        film.take(scene.ego, time_us)
    return film.develop()


def _lens(camera: FilmingCamera, focal_off: float) -> Camera:
    """The lens, its focal length longer than stated by a factor exp(`focal_off`)."""
    width, height, half = camera.width, camera.height, 0.5 * camera.horizontal_fov
    if camera.fisheye:
        pixels_per_radian = float(0.5 * width / half * np.exp(focal_off))
        return FthetaCamera.equidistant(width, height, 0.5 * (width - 1), 0.5 * (height - 1), pixels_per_radian)
    fov = 2.0 * np.arctan(np.tan(half) * np.exp(-focal_off))
    return PinholeCamera.from_field_of_view(width, height, float(fov))


def _mount(camera: FilmingCamera, true: bool) -> Array:
    height = camera.mounting_height * (np.exp(camera.height_off) if true else 1.0)
    pitch, yaw = (camera.pitch, camera.yaw) if true else (camera.stated_pitch, camera.stated_yaw)
    return camera_pose_in_rig([_FORWARD, _LEFT, height], camera.roll, pitch, yaw)


def _digest(specification: ClipSpecification) -> str:
    return hashlib.sha256(f"{_source_digest()} {specification!r}".encode()).hexdigest()[:16]


@lru_cache(maxsize=1)
def _source_digest() -> str:
    package = Path(__file__).resolve().parents[1]
    files = sorted(path for folder in _SOURCES for path in (package / folder).rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def _write_frames(path: Path, frames: NDArray[np.uint8]) -> None:
    with write_whole(path) as temporary, av.open(str(temporary), "w", format="matroska") as container:
        stream = container.add_stream("libx264rgb", rate=10)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt, stream.thread_count = "rgb24", 1
        stream.options = {"qp": "0", "preset": "ultrafast", "threads": "1"}  # no quantization: no loss
        for image in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")))
        container.mux(stream.encode())


def _read_frames(path: Path) -> NDArray[np.uint8]:
    with av.open(str(path), "r") as container:
        frames = container.decode(video=0)
        return np.stack([np.asarray(frame.to_ndarray(format="rgb24"), np.uint8) for frame in frames])
