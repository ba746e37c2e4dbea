"""A world of round spots beside and on a road, drawn in milliseconds: enough to follow, and exact."""

import cv2
import numpy as np

from olt_generator.poses import invert, planar_pose, transform
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import CameraStream, Clip, ClipOrigin, EgoMotion, ViewProvenance, make_clip_id
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.decoded_videos import ClipVideos
from olt_toolkit.clips.verification.findings import Verdict
from olt_toolkit.clips.verification.image_checks import check_images
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, POLICY_CAMERAS
from olt_toolkit.rigs.rig_files import pav_rig

WIDTH, HEIGHT = 320, 180


def bend_motion(times_us, sign=1.0, pace=1.0):
    """Rig poses (n, 4, 4) of a drive that first goes straight, then turns, and changes its speed all along."""
    fine = np.arange(-500_000, int(times_us.max()) + 500_001, 10_000)
    seconds = fine * 1e-6
    speed = pace * (9.0 + 3.0 * np.sin(1.1 * seconds))
    yaw = sign * np.cumsum(0.35 * np.sin(0.9 * seconds) ** 2 * (seconds > 0.0)) * 0.01
    x, y = np.cumsum(speed * np.cos(yaw)) * 0.01, np.cumsum(speed * np.sin(yaw)) * 0.01
    return planar_pose(*(np.interp(times_us, fine, values) for values in (x, y, yaw)))


def blob_clip(name="blobs", seed=0, frames=45, motion=bend_motion):
    """A clip of the four policy cameras at 10 Hz through the world of that seed."""
    times_us = 100_000 * np.arange(frames, dtype=np.int64)
    T_world_rig = motion(times_us)
    rig, streams = pav_rig().fitted(WIDTH, HEIGHT), {}
    world = _spots(seed)
    for camera in POLICY_CAMERAS:
        mounted = rig[camera]
        images = np.stack([_draw(mounted, pose, *world) for pose in T_world_rig])
        streams[camera] = CameraStream(images, times_us, 10.0, mounted.camera, mounted.T_rig_camera)
    return Clip(
        clip_id=make_clip_id("blobs", name),
        name=name,
        scene_id=name,
        source="test",
        origin=ClipOrigin(name, 0, int(times_us[-1])),
        kind="GT",
        category="nominal",
        factors=(),
        split="train",
        streams=streams,
        ego_motion=EgoMotion.from_trajectory(Trajectory(times_us, T_world_rig)),
        vehicle=DEFAULT_VEHICLE,
        provenance={camera: ViewProvenance("rendered", "test", "1", None, 1.0, 0.0) for camera in streams},
    )


def look(folder, *clips):
    """What images say of the first of some clips, in a store of them all."""
    store = ClipStore(folder / "store")
    for clip in clips:
        store.prepare(clip)
    store.commit([clip.clip_id for clip in clips])
    return list(check_images(store, clips[0].clip_id, ClipVideos(store, clips[0].clip_id)))


def failed(findings):
    return {each.check for each in findings if each.verdict is Verdict.FAILED}


def _spots(seed):
    """Places (n, 3), radii (n,) in metres and grey levels (n,): half on the ground, half above and beside the road."""
    generator = np.random.default_rng(seed)
    ground = np.stack([generator.uniform(-40, 130, 2500), generator.uniform(-50, 70, 2500), np.zeros(2500)], axis=1)
    high = np.stack(
        [generator.uniform(-40, 160, 2500), generator.uniform(-70, 90, 2500), generator.uniform(0.3, 14, 2500)], axis=1
    )
    places = np.concatenate([ground, high])
    return places, generator.uniform(0.1, 0.5, len(places)), generator.integers(20, 236, len(places))


def _draw(mounted, T_world_rig, places, radii, greys):
    image = np.full((HEIGHT, WIDTH), 128, np.uint8)
    points = transform(invert(T_world_rig @ mounted.T_rig_camera), places)
    pixels, seen = mounted.camera.project(points)
    distance = np.linalg.norm(points, axis=1)
    size = radii / distance * mounted.camera.pixels_per_radian[0]
    shown = np.flatnonzero(seen & (distance > 2.0) & (size > 0.4))
    for index in shown[np.argsort(-distance[shown])].tolist():
        centre = tuple(np.rint(16 * pixels[index]).astype(int).tolist())
        cv2.circle(image, centre, round(16 * size[index]), int(greys[index]), cv2.FILLED, cv2.LINE_AA, 4)
    return np.repeat(image[..., None], 3, axis=-1)
