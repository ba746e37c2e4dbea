"""The bonnet in real dashcam videos."""

from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from olt_generator.cameras import PinholeCamera
from olt_generator.distance.depth import road_distance
from olt_generator.distance.ego_vehicle import find_ego_vehicle
from olt_generator.poses import camera_pose_in_rig


def read_frames(path: Path, count: int) -> np.ndarray:
    frames: list[np.ndarray] = []
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            frames.append(cv2.resize(frame.to_ndarray(format="rgb24"), (832, 468), interpolation=cv2.INTER_AREA))
            if len(frames) == count:
                break
    return np.stack(frames)


@pytest.mark.parametrize(
    ("video", "field_of_view", "least", "most"),
    [
        ("urban_front_wide_1920x1080_30fps.mp4", 100.0, 0.08, 0.25),
        ("highway_solid_white_right_960x540_25fps.mp4", 70.0, 0.0, 0.0),
    ],
)
def test_bonnet_is_found_where_there_is_one(shared_real, video, field_of_view, least, most):
    frames = read_frames(shared_real / "dashcam_videos" / video, 40)
    camera = PinholeCamera.from_field_of_view(832, 468, float(np.radians(field_of_view)))
    T_rig_camera = camera_pose_in_rig([1.7, 0.0, 1.5], 0.0, 0.0, 0.0)
    positions = np.stack([1.0 * np.arange(40), np.zeros(40), np.zeros(40)], axis=1)
    vehicle = find_ego_vehicle(frames, camera, T_rig_camera, positions, road_distance(camera, T_rig_camera))
    assert least <= vehicle.mean() <= most
    assert not vehicle[: 468 // 2].any()
