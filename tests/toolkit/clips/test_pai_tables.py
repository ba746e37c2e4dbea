"""What the columns of the tables hold, by the names of docs/formats/physicalai_av.md."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from olt_generator.lenses.lens_curves import evaluate
from olt_toolkit.clips.pai_tables import (
    egomotion_table,
    extrinsics_table,
    intrinsics_table,
    read_egomotion,
    to_bytes,
    vehicle_table,
)

ROLL_PITCH_YAW = (0.06, 0.04, 0.0)  # of the bend at clip time 0


@pytest.fixture(scope="module")
def clip(make_clip):
    return make_clip("tables", 2.0)


def test_ego_motion_by_its_columns(clip):
    table, motion = egomotion_table(clip.ego_motion), clip.ego_motion
    roll, pitch, yaw = 0.5 * np.array(ROLL_PITCH_YAW)
    first = table.iloc[0]
    assert first["qx"] == pytest.approx(np.sin(roll) * np.cos(pitch) * np.cos(yaw), abs=1e-9)
    assert first["qy"] == pytest.approx(np.cos(roll) * np.sin(pitch) * np.cos(yaw), abs=1e-9)
    assert first["qz"] == pytest.approx(-np.sin(roll) * np.sin(pitch) * np.cos(yaw), abs=1e-9)
    assert first["qw"] == pytest.approx(np.cos(roll) * np.cos(pitch) * np.cos(yaw), abs=1e-9)
    for axis, name in enumerate("xyz"):
        np.testing.assert_array_equal(table[name], motion.trajectory.positions[:, axis])
        np.testing.assert_array_equal(table[f"v{name}"], motion.velocity[:, axis])
        np.testing.assert_array_equal(table[f"a{name}"], motion.acceleration[:, axis])
    assert table["timestamp"].tolist() == list(range(0, 2_000_000, 100_000))
    np.testing.assert_array_equal(table["curvature"], motion.curvature)
    assert len({tuple(table[name]) for name in ("x", "y", "vx", "vy", "ax", "ay", "qx", "qy", "qz", "qw")}) == 10


def test_ego_motion_is_read_by_its_columns(clip):
    table = egomotion_table(clip.ego_motion).assign(z=3.0, vz=4.0, az=5.0)
    motion = read_egomotion(to_bytes(table[sorted(table.columns)]), "ego motion")
    quaternions = table[["qx", "qy", "qz", "qw"]].to_numpy()
    rotation = Rotation.from_quat(quaternions).as_matrix()
    np.testing.assert_allclose(motion.trajectory.T_world_rig[:, :3, :3], rotation, atol=1e-12)
    np.testing.assert_array_equal(motion.trajectory.positions, table[["x", "y", "z"]])
    np.testing.assert_array_equal(motion.velocity, table[["vx", "vy", "vz"]])
    np.testing.assert_array_equal(motion.acceleration, table[["ax", "ay", "az"]])


def test_calibration_by_its_columns(clip):
    intrinsics = intrinsics_table(clip.clip_id, clip.streams)
    extrinsics = extrinsics_table(clip.clip_id, clip.streams)
    assert list(intrinsics.index.names) == ["clip_id", "camera_name"]
    assert list(extrinsics.index.names) == ["clip_id", "sensor_name"]
    for name, stream in clip.streams.items():
        lens, pose = intrinsics.loc[clip.clip_id, name], extrinsics.loc[clip.clip_id, name]
        assert (lens["width"], lens["height"]) == (128, 72)
        angle = 0.2
        pixel = stream.camera.project(np.array([np.sin(angle), 0.0, np.cos(angle)]))[0]
        radius = float(np.hypot(*(pixel - [lens["cx"], lens["cy"]])))
        forward, backward = ([lens[f"{way}_poly_{power}"] for power in range(5)] for way in ("fw", "bw"))
        assert evaluate(tuple(forward), np.array(angle)) == pytest.approx(radius, abs=1e-6)
        assert evaluate(tuple(backward), np.array(radius)) == pytest.approx(angle, abs=1e-4)
        rotation = Rotation.from_quat([pose[key] for key in ("qx", "qy", "qz", "qw")]).as_matrix()
        np.testing.assert_allclose(rotation, stream.T_rig_camera[:3, :3], atol=1e-12)
        np.testing.assert_array_equal([pose[key] for key in "xyz"], stream.T_rig_camera[:3, 3])


def test_the_vehicle_by_its_columns(clip):
    row = vehicle_table(clip.clip_id, clip.vehicle).loc[clip.clip_id]
    assert row.to_dict() == vars(clip.vehicle)
