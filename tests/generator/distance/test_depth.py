"""Distance estimates on a street whose true distances are known."""

from itertools import pairwise

import cv2
import numpy as np
import pytest

from olt_generator.cameras import PinholeCamera, pixel_rays
from olt_generator.distance.depth import (
    FAR_DISTANCE,
    DistanceEstimate,
    DistanceOrigin,
    SweepSettings,
    estimate_distance,
    road_distance,
)
from olt_generator.distance.ego_vehicle import find_ego_vehicle
from olt_generator.distance.plane_sweep import BASELINES, choose_partners
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig, planar_pose, transform
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_toolkit.benchmarks.street import BOXES, Box, render_street

CAMERA = PinholeCamera.from_field_of_view(416, 240, float(np.radians(90.0)))
T_RIG_CAMERA = camera_pose_in_rig([1.7, 0.0, 1.5], 0.0, 0.03, 0.01)
COUNT = 10


def trajectory_of(step: float, count: int = COUNT) -> Trajectory:
    index = np.arange(count)
    return Trajectory(index * 100_000, planar_pose(step * index, 0.0, 0.004 * step * index))


DRIVE = trajectory_of(1.6)


@pytest.fixture(scope="module")
def rendered() -> tuple[np.ndarray, np.ndarray]:
    """Images and distances of the drive."""
    images, distance = zip(*(render_street(CAMERA, pose @ T_RIG_CAMERA) for pose in DRIVE.T_world_rig), strict=True)
    return np.stack(images), np.stack(distance)


@pytest.fixture(scope="module")
def frames(rendered) -> np.ndarray:
    return rendered[0]


@pytest.fixture(scope="module")
def estimate(frames) -> DistanceEstimate:
    return estimate_distance(frames, CAMERA, DRIVE, T_RIG_CAMERA)


@pytest.fixture(scope="module")
def true_distance(rendered) -> np.ndarray:
    return np.minimum(rendered[1], FAR_DISTANCE)


def test_every_rule_is_right_about_its_pixels(estimate, true_distance):
    relative_error = np.abs(estimate.distance - true_distance) / true_distance
    assert estimate.distance.dtype == np.float32
    assert np.median(relative_error[estimate.origin == DistanceOrigin.PLANE]) < 0.001
    assert np.median(relative_error[estimate.origin == DistanceOrigin.PARALLAX]) < 0.05
    assert np.median(relative_error[estimate.origin == DistanceOrigin.INTERPOLATED]) < 0.15
    assert np.median(relative_error[estimate.origin == DistanceOrigin.FAR]) < 0.001
    for origin, least in ((DistanceOrigin.PLANE, 0.1), (DistanceOrigin.PARALLAX, 0.1), (DistanceOrigin.FAR, 0.1)):
        assert np.mean(estimate.origin == origin) > least
    assert not np.any(estimate.origin == DistanceOrigin.VEHICLE)


def test_most_pixels_are_right_and_parallax_is_why(estimate, true_distance):
    background = np.minimum(road_distance(CAMERA, T_RIG_CAMERA), FAR_DISTANCE)
    right = np.abs(estimate.distance - true_distance) < 0.1 * true_distance
    right_without_parallax = np.abs(background - true_distance) < 0.1 * true_distance
    assert right.mean() > 0.75
    assert right.mean() > right_without_parallax.mean() + 0.2


def test_every_frame_has_parallax(estimate):
    assert np.all((estimate.origin == DistanceOrigin.PARALLAX).mean(axis=(1, 2)) > 0.05)


def test_confidence_is_the_share_of_pixels_that_are_right(estimate, true_distance):
    right = np.abs(estimate.distance - true_distance) < 0.1 * true_distance
    assert estimate.confidence.dtype == np.float32
    assert estimate.confidence.min() >= 0.0 and estimate.confidence.max() <= 1.0
    shares = [right[level].mean() for level in confidence_levels(estimate.confidence)]
    assert np.all(np.diff(shares) > -0.02)
    assert shares[-1] > 0.95 and shares[-1] - shares[0] > 0.3
    assert abs(right.mean() - estimate.confidence.mean()) < 0.1


def confidence_levels(confidence: np.ndarray) -> list[np.ndarray]:
    """Masks of the pixels in four ranges of confidence."""
    limits = (0.0, 0.4, 0.6, 0.9, 1.01)
    return [(confidence >= low) & (confidence < high) for low, high in pairwise(limits)]


def test_only_the_frames_that_are_shown_are_estimated(frames, estimate):
    shown = estimate_distance(frames, CAMERA, DRIVE, T_RIG_CAMERA, frame_indices=[7, 2])
    assert shown.distance.shape == (2, 240, 416)
    for part in ("distance", "origin", "confidence", "moving"):
        assert np.array_equal(getattr(shown, part), getattr(estimate, part)[[7, 2]])
    with pytest.raises(InputError, match="no frame 10"):
        estimate_distance(frames, CAMERA, DRIVE, T_RIG_CAMERA, frame_indices=[10])


def test_standstill_leaves_road_and_far(frames):
    estimate = estimate_distance(frames, CAMERA, trajectory_of(0.0), T_RIG_CAMERA)
    road = road_distance(CAMERA, T_RIG_CAMERA)
    assert np.array_equal(estimate.distance[3], np.minimum(road, FAR_DISTANCE))
    assert np.array_equal(estimate.origin[3] == DistanceOrigin.PLANE, road < FAR_DISTANCE)
    assert set(np.unique(estimate.origin)) == {DistanceOrigin.PLANE, DistanceOrigin.FAR}


def test_plain_images_leave_road_and_far():
    grey = np.full((COUNT, CAMERA.height, CAMERA.width, 3), 90, np.uint8)
    estimate = estimate_distance(grey, CAMERA, DRIVE, T_RIG_CAMERA)
    assert set(np.unique(estimate.origin)) == {DistanceOrigin.PLANE, DistanceOrigin.FAR}


def test_one_frame_is_enough(frames):
    single = Trajectory(DRIVE.timestamps_us[:1], DRIVE.T_world_rig[:1])
    estimate = estimate_distance(frames[:1], CAMERA, single, T_RIG_CAMERA)
    assert estimate.distance.shape == (1, 240, 416)
    assert np.all(np.isfinite(estimate.distance)) and not estimate.confidence.any()


SMALL = CAMERA.resized(104, 60)


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("standstill", False),
        ("pure rotation", False),
        ("black", False),
        ("saturated", False),
        ("100 m apart", True),
        ("gap", True),
        ("sky only", True),
        ("ground only", True),
    ],
)
def test_extremes_give_finite_distances_and_no_confidence_from_nothing(name, known):
    index = np.arange(6)
    poses = planar_pose(1.6 * index, 0.0, 0.0)
    mounting = T_RIG_CAMERA
    if name == "standstill":
        poses = planar_pose(0.0 * index, 0.0, 0.0)
    elif name == "pure rotation":
        poses, mounting = planar_pose(0.0, 0.0, 0.1 * index), camera_pose_in_rig([0.0, 0.0, 1.5], 0.0, 0.03, 0.0)
    elif name == "100 m apart":
        poses = planar_pose(100.0 * index, 0.0, 0.0)
    elif name == "gap":
        poses = planar_pose(1.6 * index + 50.0 * (index > 2), 0.0, 0.0)
    elif name in ("sky only", "ground only"):
        mounting = camera_pose_in_rig([1.7, 0.0, 1.5], 0.0, -1.2 if name == "sky only" else 1.2, 0.0)
    frames = np.stack([render_street(SMALL, pose @ mounting)[0] for pose in poses])
    if name in ("black", "saturated"):
        frames = np.full_like(frames, 0 if name == "black" else 255)
    estimate = estimate_distance(frames, SMALL, Trajectory(100_000 * index, poses), mounting)
    assert np.all(np.isfinite(estimate.distance)) and np.all(estimate.distance > 0.0)
    assert np.all(np.isfinite(estimate.confidence))
    assert known or not estimate.confidence.any()


def test_a_van_that_goes_ahead_is_noticed_and_stands_on_the_road():
    index = np.arange(8)
    poses = planar_pose(1.2 * index, 0.0, 0.0)
    drawn = [draw_van_ahead(pose) for pose in poses]
    frames = np.stack([image for image, _, _ in drawn])
    estimate = estimate_distance(frames, CAMERA, Trajectory(100_000 * index, poses), T_RIG_CAMERA, frame_indices=[4])
    _, truth, van = drawn[4]
    assert estimate.moving[0][van].mean() > 0.5
    assert estimate.moving[0][~van].mean() < 0.05
    error = np.abs(estimate.distance[0][van] - truth[van]) / truth[van]
    assert np.median(error) < 0.15


def draw_van_ahead(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The street with a van that keeps 16 m ahead and carries its paint along; its distance, and where the van is."""
    rear = 16.0 + pose[0, 3]
    van = Box((rear, -1.2, 0.0), (rear + 4.0, 1.2, 1.3), (60, 160, 60))
    image, without = render_street(CAMERA, pose @ T_RIG_CAMERA, BOXES[:8])
    _, distance = render_street(CAMERA, pose @ T_RIG_CAMERA, (*BOXES[:8], van))
    here = distance < without
    noise = cv2.GaussianBlur(make_generator("van").normal(0.0, 1.0, here.shape), (0, 0), 2.0)
    paint = np.clip(100.0 + 280.0 * noise, 0, 255).astype(np.uint8)
    return np.where(here[..., None], paint[..., None], image), distance, here


def test_settings_out_of_range_are_refused():
    with pytest.raises(InputError, match="planes"):
        SweepSettings(planes=1)


def test_same_bytes_at_any_number_of_threads(frames, estimate):
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1 if threads > 1 else 4)
    again = estimate_distance(frames, CAMERA, DRIVE, T_RIG_CAMERA)
    cv2.setNumThreads(threads)
    assert again.distance.tobytes() == estimate.distance.tobytes()
    assert again.origin.tobytes() == estimate.origin.tobytes()


def test_progress_rises_to_one(frames):
    shares: list[float] = []
    estimate_distance(frames, CAMERA, DRIVE, T_RIG_CAMERA, shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@pytest.fixture(scope="module")
def long_drive() -> tuple[np.ndarray, PinholeCamera, Trajectory]:
    """Twenty small frames over 30 metres."""
    camera, trajectory = CAMERA.resized(208, 120), trajectory_of(1.6, count=20)
    frames = np.stack([render_street(camera, pose @ T_RIG_CAMERA)[0] for pose in trajectory.T_world_rig])
    return frames, camera, trajectory


def with_bonnet(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frames with a patterned bonnet painted over the bottom, and where it is."""
    rows, columns = np.indices(frames.shape[1:3])
    bonnet = rows > 100.0 + 6.0 * ((columns - 104.0) / 104.0) ** 2
    pattern = cv2.GaussianBlur(make_generator("bonnet").uniform(0, 255, (*bonnet.shape, 3)), (0, 0), 1.5)
    return np.where(bonnet[..., None], pattern.astype(np.uint8), frames), bonnet


def test_the_bonnet_is_found_and_not_warped(long_drive):
    frames, camera, trajectory = long_drive
    painted, bonnet = with_bonnet(frames)
    estimate = estimate_distance(painted, camera, trajectory, T_RIG_CAMERA)
    found = estimate.origin[0] == DistanceOrigin.VEHICLE
    assert (found & bonnet).sum() > 0.8 * (found | bonnet).sum()
    assert np.all(np.isnan(estimate.distance[:, found]))
    assert np.all(np.isfinite(estimate.distance[:, ~found]))


def test_road_is_not_taken_for_a_bonnet(long_drive):
    frames, camera, trajectory = long_drive
    road = road_distance(camera, T_RIG_CAMERA)
    assert not find_ego_vehicle(frames, camera, T_RIG_CAMERA, trajectory.positions, road).any()


def test_a_clip_that_stands_has_no_bonnet(long_drive):
    frames, camera, trajectory = long_drive
    painted, _ = with_bonnet(frames)
    road = road_distance(camera, T_RIG_CAMERA)
    assert not find_ego_vehicle(painted, camera, T_RIG_CAMERA, 0.0 * trajectory.positions, road).any()


def test_road_distance_ends_on_the_road():
    road = road_distance(CAMERA, T_RIG_CAMERA)
    below = np.isfinite(road)
    assert 0.4 < below.mean() < 0.6
    points = transform(T_RIG_CAMERA, (pixel_rays(CAMERA)[below] * road[below][:, None]))
    near = road[below] < 50.0
    assert np.abs(points[near, 2]).max() < 1e-4


def test_partners_lie_a_baseline_behind_and_ahead():
    positions = np.stack([0.3 * np.arange(80), np.zeros(80), np.zeros(80)], axis=1)
    partners = choose_partners(positions, 40, neighbours=2)
    assert [sorted(pair) for pair in partners] == [
        [40 - step, 40 + step] for step in np.rint(np.array(BASELINES) / 0.3)
    ]
    assert choose_partners(positions, 0, neighbours=1)[0] == [round(BASELINES[0] / 0.3)]


def test_no_partner_without_motion():
    positions = np.zeros((90, 3))
    positions[85:, 0] = 5.0
    assert choose_partners(positions, 10, 2) == [[], [], []]
    assert choose_partners(positions, 60, 2)[0] == [85]
    assert choose_partners(np.zeros((1, 3)), 0, 2) == [[], [], []]


def test_inputs_that_do_not_belong_together_are_refused(frames):
    with pytest.raises(InputError, match="9 frames for 10 poses"):
        estimate_distance(frames[:9], CAMERA, DRIVE, T_RIG_CAMERA)
    with pytest.raises(InputError, match="208 x 120"):
        estimate_distance(frames, CAMERA.resized(208, 120), DRIVE, T_RIG_CAMERA)
    with pytest.raises(InputError, match="above the road"):
        estimate_distance(frames, CAMERA, DRIVE, camera_pose_in_rig([1.7, 0.0, 0.0], 0.0, 0.0, 0.0))
