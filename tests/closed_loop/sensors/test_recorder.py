"""Recorded drives: what a clip is built from, and how it belongs together."""

import numpy as np
import pytest

from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.sensors.ray_casting import SceneRenderer
from olt_closed_loop.sensors.recorder import record_drive
from olt_generator.errors import InputError
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import CROSS_LEFT, FRONT_TELE, FRONT_WIDE
from olt_toolkit.rigs.rig_files import pav_rig

SIZE = (56, 32)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return generate_scene("animal", 2)


@pytest.fixture(scope="module")
def shares() -> list[float]:
    return []


@pytest.fixture(scope="module")
def recording(scene: Scene, shares: list[float]) -> Recording:
    return record_drive(scene, *SIZE, 3.0, (FRONT_WIDE, CROSS_LEFT, FRONT_TELE), True, shares.append)


def test_recording_covers_the_whole_drive_at_the_frame_rate(scene: Scene, recording: Recording) -> None:
    assert recording.timestamps_us.dtype == np.int64
    assert recording.timestamps_us[:4].tolist() == [0, 333_333, 666_667, 1_000_000]
    assert 0 <= scene.ego.timestamps_us[-1] - recording.timestamps_us[-1] < 333_334
    assert recording.frames.shape == (len(recording.timestamps_us), 32, 56, 3)
    assert recording.frames.dtype == np.uint8


def test_recording_says_where_it_comes_from(scene: Scene, recording: Recording) -> None:
    assert (recording.name, recording.source, recording.assumptions) == (scene.name, "synthetic", ())
    assert recording.vehicle == scene.vehicle
    front = pav_rig().fitted(*SIZE)[FRONT_WIDE]
    assert recording.camera == front.camera
    assert np.array_equal(recording.T_rig_camera, front.T_rig_camera)
    assert recording.reference is not None
    assert np.array_equal(recording.reference.timestamps_us, recording.timestamps_us)


def test_frames_views_and_distance_are_those_of_the_renderer(scene: Scene, recording: Recording) -> None:
    renderer, rig = SceneRenderer(scene), pav_rig().fitted(*SIZE)
    assert recording.reference is not None and recording.distance is not None
    assert set(recording.views) == {CROSS_LEFT, FRONT_TELE}
    for index in (0, 7, len(recording.timestamps_us) - 1):
        pose, time_us = recording.reference.T_world_rig[index], int(recording.timestamps_us[index])
        for name, images in {FRONT_WIDE: recording.frames, **recording.views}.items():
            picture = renderer.render(rig[name].camera, pose @ rig[name].T_rig_camera, time_us)
            assert np.array_equal(images[index], picture.rgb)
            if name == FRONT_WIDE:
                assert np.array_equal(recording.distance[index], picture.distance)


def test_progress_reaches_the_end(recording: Recording, shares: list[float]) -> None:
    assert shares == sorted(shares) and shares[-1] == 1.0 and len(shares) == len(recording.frames)


def test_only_what_is_asked_for_is_kept(scene: Scene) -> None:
    plain = record_drive(scene, *SIZE, 0.25)
    assert plain.distance is None and plain.views == {}
    assert len(plain.frames) == 4


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan")])
def test_bad_frame_rate_is_refused(scene: Scene, rate: float) -> None:
    with pytest.raises(InputError, match="frame rate"):
        record_drive(scene, *SIZE, rate)


def test_unknown_camera_is_refused(scene: Scene) -> None:
    with pytest.raises(InputError, match="no camera 'roof'"):
        record_drive(scene, *SIZE, 1.0, ("roof",))
