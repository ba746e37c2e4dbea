"""What the columns of the tables hold, by the names of docs/formats/physicalai_av.md."""

from dataclasses import asdict

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from olt_generator.errors import InputError
from olt_generator.lenses.lens_curves import evaluate
from olt_toolkit.clips.pai_tables import (
    egomotion_table,
    extrinsics_table,
    intrinsics_table,
    read_egomotion,
    read_indexed,
    read_timestamps,
    read_vehicle,
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


def test_one_quaternion_that_is_far_from_unit_length_is_refused(clip):
    table = egomotion_table(clip.ego_motion)
    quaternion = ["qx", "qy", "qz", "qw"]
    table.loc[7, quaternion] *= 0.6
    np.testing.assert_allclose(
        read_egomotion(to_bytes(table), "motion").trajectory.T_world_rig,
        clip.ego_motion.trajectory.T_world_rig,
        atol=1e-12,
    )
    table.loc[7, quaternion] *= 0.8
    with pytest.raises(InputError, match="motion: columns qx, qy, qz, qw hold quaternions that are not unit length"):
        read_egomotion(to_bytes(table), "motion")


def test_one_time_that_repeats_is_refused_and_two_a_microsecond_apart_are_not():
    times = np.array([0, 1, 7], np.int64)
    assert read_timestamps(to_bytes(pd.DataFrame({"timestamp": times})), "frames").tolist() == [0, 1, 7]
    assert read_timestamps(to_bytes(pd.DataFrame({"timestamp": times[:2]})), "frames").tolist() == [0, 1]
    for refused in (times[:1], np.array([0, 1, 1, 7], np.int64), np.array([0, 7, 1], np.int64)):
        with pytest.raises(InputError, match="at least two strictly increasing times"):
            read_timestamps(to_bytes(pd.DataFrame({"timestamp": refused})), "frames")


def test_a_vehicle_with_one_number_missing_and_a_clip_with_two_rows_are_refused(clip, tmp_path):
    path = tmp_path / "vehicle.parquet"
    table = vehicle_table(clip.clip_id, clip.vehicle)
    path.write_bytes(to_bytes(table))
    assert asdict(read_vehicle(path, clip.clip_id)) == asdict(clip.vehicle)
    path.write_bytes(to_bytes(table.assign(width=np.nan)))
    with pytest.raises(InputError, match=f"row {clip.clip_id} holds values that are not finite"):
        read_vehicle(path, clip.clip_id)
    path.write_bytes(to_bytes(pd.concat([table, table])))
    with pytest.raises(InputError, match=f"clip_id {clip.clip_id} is there more than once"):
        read_indexed(path, ["width"], ["clip_id"])
