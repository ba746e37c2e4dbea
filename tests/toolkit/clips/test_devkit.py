"""The public PhysicalAI-AV devkit reads what the clip store writes, and reads the same."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from olt_generator.cameras import pixel_rays
from olt_generator.poses import invert, make_pose
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.policy.sample import SampleKey
from olt_toolkit.policy.window import FUTURE_OFFSETS_US, HISTORY_OFFSETS_US, IMAGE_OFFSETS_US
from olt_toolkit.rigs.rig import POLICY_CAMERAS

REVISION = "0" * 40
T0_US = 2_010_000  # between frames and between poses


@pytest.fixture(scope="module")
def clip(make_clip):
    """A clip of which one view is partly invented, so that its masks lie beside what the devkit knows."""
    clip = make_clip("devkit")
    stream = clip.streams[POLICY_CAMERAS[0]]
    origin = np.zeros(stream.frames.shape[:3], np.uint8)
    origin[:, :9] = 1
    view = clip.provenance[POLICY_CAMERAS[0]].with_shares(origin)
    return replace(
        clip,
        streams=clip.streams | {POLICY_CAMERAS[0]: replace(stream, origin=origin)},
        provenance=clip.provenance | {POLICY_CAMERAS[0]: view},
    )


@pytest.fixture(scope="module")
def store(clip, tmp_path_factory):
    store = ClipStore(tmp_path_factory.mktemp("clips"))
    store.prepare(clip)
    store.commit([clip.clip_id])
    return store


@pytest.fixture(scope="module")
def devkit(store, tmp_path_factory):
    """The devkit's interface on the store, offline: it reads a hub cache only, so the cache points to the store."""
    pytest.importorskip("physical_ai_av", reason="physical-ai-av (extra `interop`) is not installed")
    import huggingface_hub.constants
    from physical_ai_av import PhysicalAIAVDatasetInterface

    cache = tmp_path_factory.mktemp("cache")
    snapshots = cache / "datasets--nvidia--PhysicalAI-Autonomous-Vehicles" / "snapshots"
    snapshots.mkdir(parents=True)
    (snapshots / REVISION).symlink_to(store.root, target_is_directory=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
        yield PhysicalAIAVDatasetInterface(REVISION, cache_dir=cache, token=False)


def test_index_and_presence(devkit, clip, store):
    assert (store.root / "pixel_origin").is_dir()
    assert devkit.clip_index.index.tolist() == [clip.clip_id]
    assert devkit.get_clip_chunk(clip.clip_id) == 0
    assert devkit.chunk_feature_presence.loc[0, [*POLICY_CAMERAS, "egomotion", "camera_intrinsics"]].all()
    assert devkit.features.LABELS.EGOMOTION == "egomotion"
    assert devkit.features.CAMERA.CAMERA_FRONT_TELE_30FOV == "camera_front_tele_30fov"
    assert isinstance(devkit.data_collection, pd.DataFrame)


def test_poses_are_those_of_our_reader(devkit, store, clip):
    sample = store.load_sample(SampleKey(str(store.root), clip.clip_id, T0_US))
    motion = devkit.get_clip_feature(clip.clip_id, devkit.features.LABELS.EGOMOTION)
    state = motion(T0_US + np.concatenate([HISTORY_OFFSETS_US, FUTURE_OFFSETS_US]))
    poses = make_pose(state.pose.rotation.as_matrix(), state.pose.translation)
    relative = invert(poses[15]) @ poses
    np.testing.assert_allclose(sample.ego_history_xyz[0], relative[:16, :3, 3], atol=1e-6)
    np.testing.assert_allclose(sample.ego_future_xyz[0], relative[16:, :3, 3], rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(sample.ego_future_rot[0], relative[16:, :3, :3], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(state.velocity, axis=1), 8.0, rtol=1e-2)
    np.testing.assert_allclose(state.curvature[:, 0], 0.02, atol=1e-4)


@pytest.mark.parametrize("index", range(4))
def test_frames_are_those_of_our_reader(devkit, store, clip, index):
    sample = store.load_sample(SampleKey(str(store.root), clip.clip_id, T0_US))
    reader = devkit.get_clip_feature(clip.clip_id, POLICY_CAMERAS[index])
    frames, timestamps_us = reader.decode_images_from_timestamps(T0_US + IMAGE_OFFSETS_US)
    np.testing.assert_array_equal(sample.image_frames[index], frames.transpose(0, 3, 1, 2))
    np.testing.assert_array_equal(sample.absolute_timestamps[index], timestamps_us)


def test_every_frame_of_a_stream_is_the_one_that_was_written(devkit, clip):
    reader = devkit.get_clip_feature(clip.clip_id, POLICY_CAMERAS[2])
    stream = clip.streams[POLICY_CAMERAS[2]]
    frames, _ = reader.decode_images_from_timestamps(stream.timestamps_us)
    np.testing.assert_allclose(frames.mean(axis=(1, 2, 3)), stream.frames.mean(axis=(1, 2, 3)), atol=1.2)


def test_calibration_is_that_of_the_clip(devkit, clip):
    intrinsics = devkit.get_clip_feature(clip.clip_id, devkit.features.CALIBRATION.CAMERA_INTRINSICS)
    extrinsics = devkit.get_clip_feature(clip.clip_id, devkit.features.CALIBRATION.SENSOR_EXTRINSICS)
    vehicle = devkit.get_clip_feature(clip.clip_id, devkit.features.CALIBRATION.VEHICLE_DIMENSIONS)
    for name, stream in clip.streams.items():
        rays = pixel_rays(stream.camera)[5:70:9, 3:125:9]
        pixels, _ = stream.camera.project(rays)
        np.testing.assert_allclose(intrinsics.camera_models[name].ray2pixel(rays), pixels, atol=1e-6)
        pose = extrinsics.sensor_poses[name]
        np.testing.assert_allclose(pose.as_matrix(), stream.T_rig_camera, atol=1e-12)
    assert vehicle.wheelbase == clip.vehicle.wheelbase
    assert vehicle.rear_axle_to_bbox_center == clip.vehicle.rear_axle_to_bbox_center
