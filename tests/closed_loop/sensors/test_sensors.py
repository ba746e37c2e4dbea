"""Rendered images: distances against geometry, the same ray through different lenses, and repeatable bytes."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from olt_closed_loop.scenes.conditions import Conditions
from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.scenes.scene_file import read_scene, write_scene
from olt_closed_loop.sensors.ground import Raster
from olt_closed_loop.sensors.ray_casting import SceneRenderer, render_rig
from olt_generator.cameras import FthetaCamera, PinholeCamera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.poses import R_FORWARD_CAMERA, camera_pose_in_rig
from olt_toolkit.rigs.rig import CAMERA_INDEX, FRONT_TELE, FRONT_WIDE
from olt_toolkit.rigs.rig_files import pav_rig

PINHOLE = PinholeCamera.from_field_of_view(80, 60, np.radians(80.0))
FISHEYE = FthetaCamera.equidistant(80, 60, 39.5, 29.5, 40.0)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return generate_scene("work_zone", 1)


@pytest.fixture(scope="module")
def renderer(scene: Scene) -> SceneRenderer:
    return SceneRenderer(scene)


@pytest.fixture(scope="module")
def bare(scene: Scene) -> SceneRenderer:
    """The scene without agents."""
    return SceneRenderer(replace(scene, agents=()))


def crate(name: str, T_world_rig: np.ndarray, ahead: float, left: float, size: float = 1.0, turn: float = 0.0) -> Agent:
    """A box of 1 x 1 x 4 times `size` that stands at a place relative to the rig, for a label without a body."""
    x, y = (T_world_rig @ [ahead, left, 0.0, 1.0])[:2]
    yaw = np.arctan2(T_world_rig[1, 0], T_world_rig[0, 0]) + turn
    poses = np.tile([x, y, 2.0 * size, yaw], (2, 1))
    return Agent(name, "protruding_object", size, size, 4.0 * size, np.array([0, 14_000_000]), poses)


def shoot(renderer: SceneRenderer, scene: Scene, camera=PINHOLE, roll=0.0, pitch=0.0, yaw=0.0):
    """A picture from 1.5 m above the recorded start, and the camera's pose."""
    pose = scene.ego.T_world_rig[0] @ camera_pose_in_rig([0.0, 0.0, 1.5], roll, pitch, yaw)
    return renderer.render(camera, pose, 0), pose


def distance_to_crate(rays: np.ndarray, ahead: float, left: float, turn: float) -> np.ndarray:
    """Each ray (in rig axes, from 1.5 m above the origin) against the four walls of a crate, one by one."""
    cos, sin = np.cos(turn), np.sin(turn)
    origin = np.array([-ahead * cos - left * sin, ahead * sin - left * cos])
    direction = np.stack([rays[..., 0] * cos + rays[..., 1] * sin, rays[..., 1] * cos - rays[..., 0] * sin], axis=-1)
    nearest = np.full(rays.shape[:2], np.inf)
    for axis, wall in ((0, -0.5), (0, 0.5), (1, -0.5), (1, 0.5)):
        away = (wall - origin[axis]) / direction[..., axis]
        beside = origin[1 - axis] + away * direction[..., 1 - axis]
        height = 1.5 + away * rays[..., 2]
        hit = (away > 0) & (np.abs(beside) <= 0.5) & (height >= 0.0) & (height <= 4.0)
        nearest = np.where(hit, np.minimum(nearest, away), nearest)
    return nearest


@pytest.mark.parametrize(
    ("ahead", "left", "turn"), [(8.0, 0.0, 0.0), (5.0, 2.0, 0.6), (20.0, -2.0, 2.0), (2.0, 0.5, 0.3)]
)
def test_box_is_met_where_it_stands(scene: Scene, bare: SceneRenderer, ahead: float, left: float, turn: float) -> None:
    agents = (crate("crate", scene.ego.T_world_rig[0], ahead, left, turn=turn),)
    renderer = SceneRenderer(replace(scene, agents=agents))
    for camera in (PINHOLE, FISHEYE):
        picture, empty = shoot(renderer, scene, camera)[0], shoot(bare, scene, camera)[0]
        crate_distance = distance_to_crate(pixel_rays(camera) @ R_FORWARD_CAMERA.T, ahead, left, turn)
        assert np.isfinite(crate_distance).sum() > 10
        same = np.isclose(picture.distance, np.minimum(crate_distance, empty.distance), rtol=1e-3)
        assert (~same).sum() <= 2, "only rays that graze an edge may differ"


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE])
def test_ground_distance_is_that_of_the_plane(scene: Scene, bare: SceneRenderer, camera) -> None:
    picture, pose = shoot(bare, scene, camera, roll=0.1, pitch=0.5, yaw=0.2)
    fall = -(pixel_rays(camera) @ pose[:3, :3].T)[..., 2]
    plane = np.where(fall > 1e-3, 1.5 / np.where(fall > 1e-3, fall, 1.0), np.inf)
    on_ground = (picture.distance > 0.999 * plane) & np.isfinite(plane)
    assert on_ground.mean() > 0.6
    np.testing.assert_allclose(picture.distance[on_ground], plane[on_ground], rtol=1e-3)
    assert np.all(picture.distance[np.isfinite(plane)] <= 1.001 * plane[np.isfinite(plane)])


def test_sky_is_infinitely_far_and_all_above_the_horizon(renderer: SceneRenderer, scene: Scene) -> None:
    pose = scene.ego.T_world_rig[0] @ camera_pose_in_rig([0.0, 0.0, 1.5], 0.0, -1.2, 0.0)
    picture = renderer.render(PINHOLE, pose, 0)
    up = (pixel_rays(PINHOLE) @ pose[:3, :3].T)[..., 2] > 0.0
    sky = np.isinf(picture.distance)
    assert sky.mean() > 0.8
    assert np.all(up[sky])


def test_nearer_box_hides_the_farther_one(scene: Scene) -> None:
    start = scene.ego.T_world_rig[0]
    near, far = crate("near", start, 6.0, 0.0), crate("far", start, 12.0, 1.0, size=1.5)
    choices = ((near, far), (far, near), (near,), (far,))
    both, reversed_both, only_near, only_far = (
        shoot(SceneRenderer(replace(scene, agents=agents)), scene)[0].distance for agents in choices
    )
    assert np.array_equal(both, np.minimum(only_near, only_far))
    assert np.array_equal(both, reversed_both)
    assert np.any(only_far < only_near)


def test_box_around_the_camera_and_box_behind_it(scene: Scene, bare: SceneRenderer) -> None:
    start = scene.ego.T_world_rig[0]
    around = SceneRenderer(replace(scene, agents=(crate("around", start, 0.0, 0.0, size=4.0),)))
    inside = shoot(around, scene)[0].distance
    assert inside[30, 40] == pytest.approx(2.0, rel=0.01)
    assert inside.max() < np.linalg.norm([2.0, 2.0, 14.5])
    behind = SceneRenderer(replace(scene, agents=(crate("behind", start, -3.0, 0.0),)))
    assert np.array_equal(shoot(behind, scene)[0].distance, shoot(bare, scene)[0].distance)


def test_agent_is_shown_where_it_is_at_the_time_and_only_while_it_exists(scene: Scene) -> None:
    start = scene.ego.T_world_rig[0]
    here, there = crate("box", start, 6.0, 0.0), crate("box", start, 10.0, 0.0)
    times = np.array([1_000_000, 2_000_000])
    moving = replace(here, timestamps_us=times, poses=np.stack([here.poses[0], there.poses[0]]))
    renderer = SceneRenderer(replace(scene, agents=(moving,)))
    pose = start @ camera_pose_in_rig([0.0, 0.0, 1.5], 0.0, 0.0, 0.0)
    seen = {time: renderer.render(PINHOLE, pose, time).distance[30, 40] for time in (1_000_000, 1_500_000, 2_000_000)}
    assert seen == {time: pytest.approx(away, rel=0.01) for time, away in zip(seen, (5.5, 7.5, 9.5), strict=True)}
    assert renderer.render(PINHOLE, pose, 2_000_001).distance[30, 40] > 20.0
    assert renderer.render(PINHOLE, pose, 999_999).distance[30, 40] > 20.0


def test_pinhole_and_fisheye_agree_along_the_same_ray(renderer: SceneRenderer, scene: Scene) -> None:
    pose = scene.ego.interpolate(np.array([5_000_000]))[0] @ camera_pose_in_rig([1.7, 0.0, 1.4], 0.0, 0.05, 0.0)
    wide = PinholeCamera.from_field_of_view(161, 121, np.radians(80.0))
    fisheye = FthetaCamera.equidistant(161, 121, 80.0, 60.0, 80.0)
    for shift in (0.0, 0.3, -0.4):
        pose[:3, :3] = pose[:3, :3] @ cv2.Rodrigues(np.array([0.0, shift, 0.0]))[0]
        one, other = (renderer.render(camera, pose, 5_000_000) for camera in (wide, fisheye))
        assert one.distance[60, 80] == pytest.approx(other.distance[60, 80], rel=1e-5)
        assert np.abs(one.rgb[60, 80].astype(int) - other.rgb[60, 80]).max() <= 8


def test_tele_and_wide_show_the_same_world(renderer: SceneRenderer, scene: Scene) -> None:
    rig = pav_rig().fitted(576, 320)
    pose = scene.ego.interpolate(np.array([5_000_000]))[0]
    tele, wide = rig[FRONT_TELE], rig[FRONT_WIDE]
    # Both from the same place, so that rays compare; the tele image is averaged to the wide one's resolution.
    mounting = wide.T_rig_camera.copy()
    mounting[:3, :3] = tele.T_rig_camera[:3, :3]
    near = renderer.render(tele.camera, pose @ mounting, 5_000_000)
    far = renderer.render(wide.camera, pose @ wide.T_rig_camera, 5_000_000)
    rays = pixel_rays(tele.camera) @ tele.T_rig_camera[:3, :3].T @ wide.T_rig_camera[:3, :3]
    table = wide.camera.project(rays)[0].astype(np.float32)
    expected = cv2.remap(far.rgb, table[..., 0], table[..., 1], cv2.INTER_LINEAR).astype(float)
    got = cv2.GaussianBlur(near.rgb, (0, 0), 2.0).astype(float)
    assert np.abs(got - expected).mean() < 12.0
    assert np.corrcoef(got.mean(axis=-1).ravel(), expected.mean(axis=-1).ravel())[0, 1] > 0.9


def test_same_bytes_twice_and_from_a_scene_file(scene: Scene, renderer: SceneRenderer, tmp_path: Path) -> None:
    rig = pav_rig().fitted(112, 64)
    pose = scene.ego.interpolate(np.array([6_000_000]))[0]
    first = render_rig(renderer, rig, tuple(CAMERA_INDEX), pose, 6_000_000)
    stored = SceneRenderer(read_scene(write_scene(scene, tmp_path / "scene.usda")))
    for other in (SceneRenderer(scene), stored):
        again = render_rig(other, rig, tuple(CAMERA_INDEX), pose, 6_000_000)
        for name, picture in first.items():
            assert picture.rgb.tobytes() == again[name].rgb.tobytes(), name
            assert picture.distance.tobytes() == again[name].distance.tobytes(), name
    assert first[FRONT_WIDE].rgb.shape == (64, 112, 3)


def test_features_can_be_followed_at_driving_speed(renderer: SceneRenderer, scene: Scene) -> None:
    mounted = pav_rig().fitted(576, 320)[FRONT_WIDE]
    images = [
        cv2.cvtColor(renderer.render(mounted.camera, pose @ mounted.T_rig_camera, int(time)).rgb, cv2.COLOR_RGB2GRAY)
        for time, pose in zip(
            (3_000_000, 3_100_000), scene.ego.interpolate(np.array([3_000_000, 3_100_000])), strict=True
        )
    ]
    features = cv2.goodFeaturesToTrack(images[0], 800, 0.01, 7)
    ahead, found, _ = cv2.calcOpticalFlowPyrLK(images[0], images[1], features, None)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(images[1], images[0], ahead, None)
    kept = (found == 1) & (returned == 1) & (np.linalg.norm(back - features, axis=-1) < 0.5)
    assert kept.sum() >= 200


def test_agent_without_looks_is_named(scene: Scene, tmp_path: Path) -> None:
    stored = read_scene(write_scene(scene, tmp_path / "scene.usda"))
    stranger = crate("stranger", scene.ego.T_world_rig[0], 8.0, 0.0)
    with pytest.raises(InputError, match="no colour for agent stranger"):
        SceneRenderer(replace(stored, agents=(*stored.agents, stranger)))


def test_what_is_kept_between_pictures_changes_none(scene: Scene) -> None:
    poses = scene.ego.interpolate(np.array([0, 1_500_000, 0]))
    poses[1] = (
        poses[1]
        @ camera_pose_in_rig([0.0, 0.0, 0.1], 0.02, 0.01, 0.3)
        @ np.linalg.inv(camera_pose_in_rig([0.0, 0.0, 0.0], 0.0, 0.0, 0.0))
    )
    mount = camera_pose_in_rig([0.0, 0.0, 1.5], 0.0, 0.0, 0.0)
    kept = SceneRenderer(scene)
    for pose in (*poses, poses[0]):
        fresh = SceneRenderer(scene).render(PINHOLE, pose @ mount, 0)
        again = kept.render(PINHOLE, pose @ mount, 0)
        assert np.array_equal(fresh.rgb, again.rgb) and np.array_equal(fresh.distance, again.distance)


@pytest.mark.parametrize("light", ["day", "low_sun", "night"])
def test_no_shadow_and_no_beam_stays_behind(light: str) -> None:
    scene = generate_scene("cyclists", 1)
    mount = camera_pose_in_rig([-20.0, 0.0, 25.0], 0.0, 0.7, 0.0)  # sees the road from above
    times = [0, 4_000_000, 8_000_000, 4_000_000, 0]
    kept = SceneRenderer(scene, Conditions(light))
    seen = []
    for time_us in times:
        pose = scene.ego.interpolate(np.array([4_000_000]))[0]
        picture = kept.render(PINHOLE, pose @ mount, time_us).rgb
        fresh = SceneRenderer(scene, Conditions(light)).render(PINHOLE, pose @ mount, time_us).rgb
        assert np.array_equal(picture, fresh)
        seen.append(picture)
    assert not np.array_equal(seen[0], seen[1])


@given(outlines=st.lists(arrays(np.float64, (4, 2), elements=st.floats(-40.0, 40.0, width=32)), min_size=1, max_size=3))
def test_a_patch_holds_all_that_was_drawn(outlines: list[np.ndarray]) -> None:
    raster = Raster(np.zeros((64, 64), np.uint8), np.array([-6.4, -6.4]), 0.2)
    before = raster.image.copy()
    for outline in outlines:
        raster.fill(outline, 255)
        raster.image[raster.patch(raster.fixed_point(outline))] = 0
        assert np.array_equal(raster.image, before)
