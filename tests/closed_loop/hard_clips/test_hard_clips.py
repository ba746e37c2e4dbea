"""The list of hard clips, and the recordings that are filmed from it."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from olt_closed_loop.hard_clips.filming import make_clip
from olt_closed_loop.hard_clips.kinds import KINDS, list_hard_clips, specify_clip
from olt_closed_loop.hard_clips.specification import ClipSpecification
from olt_closed_loop.hard_clips.staging import stage_scene
from olt_closed_loop.scenes.actors import clearance, ego_agent
from olt_generator.errors import InputError
from olt_generator.poses import yaw_of


@pytest.fixture(scope="module")
def clips() -> list[ClipSpecification]:
    return list_hard_clips(200)


def small(kind: str, number: int = 0, frames: int = 3) -> ClipSpecification:
    clip = specify_clip(kind, number, 0)
    return replace(clip, frames=frames, camera=replace(clip.camera, width=96, height=54))


def test_two_hundred_clips_cover_every_kind_ten_times(clips: list[ClipSpecification]) -> None:
    counts = Counter(clip.kind for clip in clips)
    assert set(counts) == set(KINDS) and min(counts.values()) >= 10
    assert len({clip.name for clip in clips}) == 200
    for clip in clips:
        assert 41 <= clip.frames <= 80
        assert 10.0 <= clip.frame_rate <= 30.0
        assert clip.camera.width * clip.camera.height <= 832 * 468


def test_the_list_depends_on_its_seed_alone(clips: list[ClipSpecification]) -> None:
    assert list_hard_clips(30) == clips[:30]
    assert list_hard_clips(3, kinds=("night",)) == [clip for clip in clips if clip.kind == "night"][:3]
    other = list_hard_clips(17, seed=1)
    assert all(one != another for one, another in zip(clips, other, strict=False))


def test_cameras_are_off_by_what_the_recording_says(clips: list[ClipSpecification]) -> None:
    cameras = [clip.camera for clip in (*clips, *list_hard_clips(200, seed=1))]
    for off in (
        [camera.height_off / camera.spread.height.relative for camera in cameras],
        [camera.focal_off / camera.spread.focal_length.relative for camera in cameras],
    ):
        assert np.mean(off) == pytest.approx(0.0, abs=0.2)
        assert np.std(off) == pytest.approx(1.0, abs=0.15)
    unknown = [clip.camera for clip in clips if clip.kind == "unknown_camera"]
    assert min(camera.spread.height.relative for camera in unknown) >= 0.03
    assert {camera.spread.height.origin for camera in unknown} == {"assumed"}


def test_each_kind_is_what_it_is_called(clips: list[ClipSpecification]) -> None:
    def motions(kind: str) -> list[np.ndarray]:
        of_kind = [clip for clip in clips if clip.kind == kind][:4]
        return [stage_scene(clip).ego.T_world_rig for clip in of_kind]

    assert all(np.ptp(poses[:, :2, 3], axis=0).max() < 1e-9 for poses in motions("standstill"))
    for poses in motions("reverse"):
        moved = poses[-1, :3, 3] - poses[0, :3, 3]
        assert moved @ poses[0, :3, 0] < -1.0
    for poses in motions("turn"):
        assert abs(np.unwrap(yaw_of(poses))[-1] - yaw_of(poses)[0]) > np.radians(50.0)
    for poses in motions("hills"):
        assert np.ptp(poses[:, 2, 0]) > 0.003, "its pitch changes"
    for poses in motions("stop_and_go"):
        speeds = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / 0.02
        assert speeds.min() < 0.02 and speeds.max() > 1.5


@pytest.mark.parametrize("kind", ["traffic", "stop_and_go", "standstill"])
def test_traffic_is_on_both_sides_and_touches_nobody(kind: str) -> None:
    for number in range(3):
        scene = stage_scene(specify_clip(kind, number, 0))
        ego = ego_agent(scene.ego, scene.vehicle)
        assert min(clearance(ego, agent) for agent in scene.agents) > 0.3
        start = scene.ego.T_world_rig[0]
        lateral = [float((agent.poses[0, :3] - start[:3, 3]) @ start[:3, 1]) for agent in scene.agents]
        assert sum(2.0 < offset < 5.0 for offset in lateral) >= 3
        assert sum(-5.0 < offset < -2.0 for offset in lateral) >= 3
        assert any(abs(offset) < 1.0 for offset in lateral), "one is ahead"


@pytest.mark.parametrize("kind", list(KINDS))
def test_every_kind_can_be_filmed(kind: str) -> None:
    clip = small(kind)
    recording = make_clip(clip)
    assert recording.frames.shape == (3, 54, 96, 3)
    assert recording.reference is not None and len(recording.reference) == 3
    np.testing.assert_allclose(recording.reference.T_world_rig[0], np.eye(4), atol=1e-12)
    assert recording.spread == clip.camera.spread
    assert recording.frames.std() > 1.0


def test_the_same_specification_gives_the_same_bytes_with_and_without_a_cache(tmp_path: Path) -> None:
    clip = small("rain")
    first = make_clip(clip)
    kept, again = make_clip(clip, tmp_path), make_clip(clip, tmp_path)
    assert first.frames.tobytes() == kept.frames.tobytes() == again.frames.tobytes()
    assert len(list(tmp_path.iterdir())) == 1
    other = make_clip(replace(clip, seed=1), tmp_path)
    assert other.frames.tobytes() != first.frames.tobytes()
    assert len(list(tmp_path.iterdir())) == 2


def test_the_camera_that_films_is_not_quite_the_one_that_is_stated() -> None:
    clip = small("low_sun")
    wrong = replace(clip.camera, height_off=0.2, focal_off=-0.1)
    taken = make_clip(replace(clip, camera=wrong))
    assert taken.T_rig_camera[2, 3] == pytest.approx(clip.camera.mounting_height)
    tall = replace(wrong, mounting_height=wrong.mounting_height * np.exp(0.2), height_off=0.0)
    wide = 2.0 * np.arctan(np.tan(0.5 * wrong.horizontal_fov) * np.exp(0.1))
    true = make_clip(replace(clip, camera=replace(tall, horizontal_fov=float(wide), focal_off=0.0)))
    assert np.array_equal(taken.frames, true.frames)
    assert true.T_rig_camera[2, 3] == pytest.approx(taken.T_rig_camera[2, 3] * np.exp(0.2))


@pytest.mark.parametrize(
    ("given", "complaint"), [({"kinds": ("fog",)}, "kind 'fog'"), ({"count": 0}, "give at least 1")]
)
def test_impossible_lists_are_refused(given: dict[str, object], complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        list_hard_clips(**given)  # type: ignore[arg-type]
