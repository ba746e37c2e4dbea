"""Clips of straight drives with grey images, made in an instant, and stores of them."""

import numpy as np

from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import CameraStream, Clip, ClipOrigin, EgoMotion, ViewProvenance, make_clip_id
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, POLICY_CAMERAS
from olt_toolkit.rigs.rig_files import pav_rig

HEIGHT, WIDTH = 36, 64


def straight_clip(
    name, rows=90, images=slice(14, 22), along=None, cameras=POLICY_CAMERAS, kind="GT", split="train", grey=60
):
    """A drive with rows of motion every 0.1 s from 0 s, and images at those of `images`, each of one grey level.

    It is `along` (rows,) metres on the way, at 5 m/s where none are given.
    """
    ego_us = 100_000 * np.arange(rows, dtype=np.int64)
    still = np.zeros(rows)
    poses = planar_pose(5e-6 * ego_us if along is None else along, still, still)
    image_us, rig = ego_us[images], pav_rig().fitted(WIDTH, HEIGHT)
    streams = {}
    for index, camera in enumerate(cameras):
        levels = np.minimum(grey + 20 * index + 2 * np.arange(len(image_us)), 255).astype(np.uint8)
        frames = np.broadcast_to(levels[:, None, None, None], (len(levels), HEIGHT, WIDTH, 3)).copy()
        streams[camera] = CameraStream(frames, image_us, 10.0, rig[camera].camera, rig[camera].T_rig_camera)
    return Clip(
        clip_id=make_clip_id(name),
        name=name,
        scene_id=name,
        source="world",
        origin=ClipOrigin(name, 0, 1_000_000, "DE", "CC BY 4.0"),
        kind=kind,
        category="nominal" if kind == "GT" else "work_zone",
        factors=(),
        split=split,
        streams=streams,
        ego_motion=EgoMotion.from_trajectory(Trajectory(ego_us, poses)),
        vehicle=DEFAULT_VEHICLE,
        provenance={camera: ViewProvenance("rendered", "test", "1", None, 1.0, 0.0) for camera in streams},
    )


def write_clips(root, *chunks):
    """A store of clips, chunk by chunk; gives its folder."""
    store = ClipStore(root)
    for clips in chunks:
        for clip in clips:
            store.prepare(clip)
        store.commit([clip.clip_id for clip in clips])
    return root
