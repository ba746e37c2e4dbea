"""Gathering from several frames against a plain loop, and which surface wins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.cameras import FthetaCamera, PinholeCamera
from olt_generator.poses import camera_pose_in_rig, invert, make_pose, pose_from_quaternion
from olt_generator.seeds import make_generator
from olt_generator.views.aggregate import SURFACE_TOLERANCE, SourceFrame, gather

FRONT = PinholeCamera.from_field_of_view(24, 16, float(np.radians(80.0)))
WIDE = FthetaCamera.equidistant(24, 16, 11.0, 9.0, 14.0)
STILL = np.eye(4)


def flat(colour: int, distance: float, T_target_camera: np.ndarray = STILL) -> SourceFrame:
    return SourceFrame(np.full((16, 24, 3), colour, np.uint8), np.full((16, 24), distance, np.float32), T_target_camera)


def gather_plainly(sources: list[SourceFrame], camera, target, radius: int) -> tuple[np.ndarray, np.ndarray]:
    """Image and source, one point after the other, by the same rule in words."""
    image = np.zeros((target.height, target.width, 3), np.uint8)
    source = np.full((target.height, target.width), len(sources))
    best: dict[tuple[int, int], tuple] = {}
    step, fine = np.log1p(SURFACE_TOLERANCE), np.log1p(0.02)
    for number, each in enumerate(sources):
        for (row, column), distance in np.ndenumerate(each.distance):
            if not distance > 0.5:
                continue
            distance = min(float(distance), 1e6)
            ray = camera.rays(np.array([column, row], np.float64))
            point = each.T_target_camera[:3, :3] @ (ray * distance) + each.T_target_camera[:3, 3]
            widened = target.cropped(-radius, -radius, target.width + 2 * radius, target.height + 2 * radius)
            (u, v), inside = widened.project(point)
            away = float(np.linalg.norm(point))
            if not inside or away <= 0.5:
                continue
            rank = (int(np.log(away / 0.5) / step), int(np.log(distance / 0.5) / fine), number, row * 24 + column)
            middle = (int(np.floor(v + 0.5)) - radius, int(np.floor(u + 0.5)) - radius)
            for down in range(-radius, radius + 1):
                for right in range(-radius, radius + 1):
                    place = (middle[0] + down, middle[1] + right)
                    in_image = 0 <= place[0] < target.height and 0 <= place[1] < target.width
                    if in_image and (place not in best or rank < best[place]):
                        best[place] = rank
                        image[place], source[place] = each.image[row, column], number
    return image, source


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32), target=st.sampled_from([FRONT, WIDE]), radius=st.integers(0, 2))
def test_equals_a_plain_loop_but_for_rounding(seed, target, radius):
    random = make_generator(seed)
    sources = []
    for _ in range(3):
        distance = random.uniform(2.0, 60.0, (16, 24)).astype(np.float32)
        odd = np.array([np.nan, np.inf, 0.0, -2.0, 0.4], np.float32)
        distance = np.where(random.random((16, 24)) < 0.2, random.choice(odd, (16, 24)), distance)
        T = pose_from_quaternion([*random.normal(0.0, 0.2, 3), 1.0], random.normal(0.0, 1.0, 3))
        sources.append(SourceFrame(random.integers(0, 256, (16, 24, 3)).astype(np.uint8), distance, T))
    gathered, gathered_source, _ = gather(sources, FRONT, target, radius)
    image, source = gather_plainly(sources, FRONT, target, radius)
    # Single precision may move a point that lies on the edge of a pixel or of a level.
    assert (gathered_source != source).mean() < 0.01
    assert (gathered != image).any(axis=-1).mean() < 0.02


def colours(gathered: tuple[np.ndarray, np.ndarray, np.ndarray]) -> set[int]:
    image, source, _ = gathered
    return set(np.unique(image[source < 2]).tolist())


def test_the_nearest_surface_wins_whichever_frame_shows_it():
    near, far = flat(200, 4.0), flat(90, 8.0)
    assert colours(gather([near, far], FRONT, FRONT)) == {200}
    assert colours(gather([far, near], FRONT, FRONT)) == {200}


def test_of_one_surface_the_frame_nearest_to_it_wins():
    """Two frames 4 m apart on the axis see the same wall, 5 and 9 m away."""
    camera = PinholeCamera.from_field_of_view(24, 16, float(np.radians(30.0)))
    at_wall = np.array(5.0 / camera.rays(np.stack(np.meshgrid(range(24), range(16)), -1).astype(float))[..., 2])
    near = SourceFrame(np.full((16, 24, 3), 200, np.uint8), at_wall.astype(np.float32), STILL)
    back = make_pose(np.eye(3), [0.0, 0.0, -4.0])
    far = SourceFrame(np.full((16, 24, 3), 90, np.uint8), (at_wall * 9.0 / 5.0 * 1.005).astype(np.float32), back)
    assert colours(gather([far, near], camera, camera)) == {200}


def test_of_equal_frames_the_first_wins():
    assert colours(gather([flat(200, 5.0), flat(90, 5.0)], FRONT, FRONT)) == {200}


def test_what_is_infinitely_far_is_turned_and_not_moved():
    image = make_generator("sky").integers(0, 256, (16, 24, 3)).astype(np.uint8)
    moved = SourceFrame(image, np.full((16, 24), np.inf, np.float32), make_pose(np.eye(3), [5.0, -2.0, 30.0]))
    gathered, _, far = gather([moved], FRONT, FRONT, radius=0)
    assert np.array_equal(gathered, image)
    assert far.all()
    aside = invert(camera_pose_in_rig([0, 0, 0], 0.0, 0.0, np.pi / 2)) @ camera_pose_in_rig([0, 0, 0], 0.0, 0.0, 0.0)
    assert not (gather([SourceFrame(image, moved.distance, aside)], FRONT, FRONT)[1] == 0).any()


def test_nothing_lands_of_what_must_not_be_taken():
    image, source, far = gather([flat(200, float("nan"))], FRONT, WIDE)
    assert np.all(source == 1)
    assert not image.any()
    assert not far.any()
