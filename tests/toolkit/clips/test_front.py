"""The front-wide view of cameras that are no front-wide cameras, and the views made of it again."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_generator.cameras import PinholeCamera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.trajectory import Trajectory
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.clips.builder import BuildOptions, build_clip
from olt_toolkit.clips.front import degrees_across, fit_width, fit_width_images, is_lens_of
from olt_toolkit.clips.images import largest_rectangle
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.view_files import reopen_clip
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.names import FrontLens
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, FRONT_TELE, FRONT_WIDE, REAR_LEFT
from olt_toolkit.rigs.rig_files import pav_rig

WIDTH, HEIGHT = 192, 108
NAMED = pav_rig().fitted(WIDTH, HEIGHT)[FRONT_WIDE]


def sky_colours(rays_rig):
    """Colours (..., 3) of a world infinitely far away, by direction (..., 3) in the rig; smooth, and never black."""
    return np.rint(128 + 80 * np.sin(5.0 * rays_rig + np.array([0.0, 1.0, 2.0]))).astype(np.uint8)


def film(camera, T_rig_camera):
    return sky_colours(pixel_rays(camera) @ T_rig_camera[:3, :3].T)


def make_recording(camera, T_rig_camera, count=31, speed=6.0):
    times_us = 100_000 * np.arange(count, dtype=np.int64)
    frames = np.repeat(film(camera, T_rig_camera)[None], count, axis=0)
    reference = Trajectory(times_us, planar_pose(speed * times_us * 1e-6, 0.0, 0.0))
    return Recording("drive", "test", frames, times_us, camera, T_rig_camera, DEFAULT_VEHICLE, reference=reference)


def build_front(recording, front=FrontLens.AS_NAMED, cameras=(FRONT_WIDE,), **changes):
    options = BuildOptions(WIDTH, HEIGHT, cameras=cameras, front=front, use_reference_motion=True)
    return build_clip(recording, replace(options, **changes))


# Much wider than high, as rectified images of stereo cameras are, and turned against the rig's own camera.
NARROW = PinholeCamera.from_field_of_view(621, 188, np.radians(82.0))
TURNED = camera_pose_in_rig([1.1, 0.2, 1.65], 0.02, 0.03, -0.05)


def test_a_narrow_front_is_shown_through_the_lens_of_its_name():
    built = build_front(make_recording(NARROW, TURNED))
    stream, view = built.clip.streams[FRONT_WIDE], built.clip.provenance[FRONT_WIDE]
    assert stream.camera == NAMED.camera
    np.testing.assert_array_equal(stream.T_rig_camera[:3, :3], NAMED.T_rig_camera[:3, :3])
    np.testing.assert_array_equal(stream.T_rig_camera[:3, 3], TURNED[:3, 3])
    seen = stream.origin == PixelOrigin.SAME_FRAME
    assert ((stream.origin == PixelOrigin.UNSEEN) == ~seen).all()
    assert stream.frames[~seen].max() == 0
    expected = film(NAMED.camera, NAMED.T_rig_camera)[seen[0]]
    np.testing.assert_allclose(stream.frames[0][seen[0]].astype(int), expected, atol=3)
    rays = pixel_rays(NAMED.camera) @ NAMED.T_rig_camera[:3, :3].T @ TURNED[:3, :3]
    inside = NARROW.project(rays)[1]
    assert (seen[0] & ~inside).sum() == 0
    assert (inside & ~seen[0]).sum() < 0.02 * inside.size  # pixels of which a part is not seen
    assert view.observed_share == pytest.approx(seen.mean())
    assert view.unseen_share == pytest.approx(1.0 - seen.mean())
    assert 0.2 < view.observed_share < 0.4
    assert any("116 degrees across; the recording's camera has 82" in note for note in built.assumptions)


def test_a_front_as_it_is_keeps_its_whole_width():
    """It was cropped to the shape of the views before: 82 degrees came out as 50."""
    built = build_front(make_recording(NARROW, TURNED), FrontLens.AS_IS)
    stream, view = built.clip.streams[FRONT_WIDE], built.clip.provenance[FRONT_WIDE]
    edges = stream.camera.rays(np.array([[-0.5, stream.camera.cy], [WIDTH - 0.5, stream.camera.cy]]))
    assert np.degrees(np.arccos(edges[0] @ edges[1])) == pytest.approx(82.0, abs=0.01)
    np.testing.assert_array_equal(stream.T_rig_camera, TURNED)
    rows = (stream.origin[0] == PixelOrigin.SAME_FRAME).all(axis=1)
    assert (rows == (stream.origin[0] == PixelOrigin.SAME_FRAME).any(axis=1)).all()
    assert rows.sum() == round(188 * WIDTH / 621)
    assert stream.frames[:, ~rows].max() == 0
    np.testing.assert_allclose(stream.frames[0][rows].astype(int), film(stream.camera, TURNED)[rows], atol=3)
    assert view.observed_share == pytest.approx(rows.mean())
    assert any("keeps the recording's lens, 82 degrees across and not 116" in note for note in built.assumptions)


def test_a_true_view_stays_what_it_is_and_says_so():
    recording = make_recording(NARROW, TURNED)
    built = build_front(recording, use_reference_views=True, use_reference_motion=False)
    as_is = build_front(recording, FrontLens.AS_IS)
    np.testing.assert_array_equal(built.clip.streams[FRONT_WIDE].frames, as_is.clip.streams[FRONT_WIDE].frames)
    assert any("keeps the recording's lens" in note for note in built.assumptions)


@pytest.mark.parametrize("front", FrontLens)
def test_the_named_lens_is_left_alone(front):
    """Also that of another vehicle, whose principal point and mounting differ a little."""
    lens = NAMED.camera
    other = lens.redrawn(WIDTH, HEIGHT, (1.01, 1.01), (lens.cx + 3.0, lens.cy - 20.0))
    for camera, pose in ((lens, NAMED.T_rig_camera), (other, TURNED)):
        recording = make_recording(camera, pose)
        built = build_front(recording, front)
        stream = built.clip.streams[FRONT_WIDE]
        np.testing.assert_array_equal(stream.frames, recording.frames)
        assert (stream.camera, stream.origin) == (camera, None)
        assert not any(FRONT_WIDE in note and "lens of that name" in note for note in built.assumptions)


def test_a_fisheye_that_sees_more_gives_a_view_of_its_name_seen_whole():
    wide = NAMED.camera.redrawn(384, 216, (1.2, 1.2), (191.5, 107.5))
    built = build_front(make_recording(wide, NAMED.T_rig_camera))
    stream = built.clip.streams[FRONT_WIDE]
    assert stream.camera == NAMED.camera
    assert stream.origin is None
    np.testing.assert_allclose(stream.frames[0].astype(int), film(NAMED.camera, NAMED.T_rig_camera), atol=3)


def test_a_camera_that_looks_elsewhere_is_refused_as_named():
    back = camera_pose_in_rig([0.0, 0.0, 1.5], 0.0, 0.0, np.pi)
    with pytest.raises(InputError, match="sees nothing of camera_front_wide_120fov; give --front as-is"):
        build_front(make_recording(NARROW, back))


def test_the_tele_view_is_cut_out_of_the_recording_whatever_the_front_view_is():
    recording = make_recording(NARROW, TURNED)
    named, as_is = (build_front(recording, front, (FRONT_WIDE, FRONT_TELE)).clip for front in FrontLens)
    np.testing.assert_array_equal(named.streams[FRONT_TELE].frames, as_is.streams[FRONT_TELE].frames)
    assert named.provenance[FRONT_TELE].is_seen_whole


def test_views_of_a_stored_clip_are_not_made_of_its_black_borders(tmp_path):
    store = ClipStore(tmp_path)
    clip = build_front(make_recording(NARROW, TURNED)).clip
    store.prepare(clip)
    store.commit([clip.clip_id])
    recording = reopen_clip(store, clip.clip_id)
    assert recording.frames.min() > 30
    shown = film(recording.camera, recording.T_rig_camera)
    assert np.abs(recording.frames[0].astype(int) - shown).mean() < 6.0  # as a video keeps it
    assert recording.frames[0].size > 0.8 * 3 * (clip.streams[FRONT_WIDE].origin[0] == PixelOrigin.SAME_FRAME).sum()


def test_a_standing_vehicle_sees_nothing_behind_and_says_so():
    recording = make_recording(NARROW, TURNED, speed=0.0)
    built = build_front(recording, cameras=(FRONT_WIDE, REAR_LEFT))
    view, stream = built.clip.provenance[REAR_LEFT], built.clip.streams[REAR_LEFT]
    assert (view.observed_share, view.invented_share) == (0.0, 1.0)
    assert (stream.origin == PixelOrigin.INVENTED).all()
    assert any("saw nothing of 31 of its 31 images" in n and "driven past" in n for n in built.assumptions)


@given(st.integers(20, 400), st.integers(20, 400))
def test_images_and_camera_are_fitted_alike(width, height):
    camera = PinholeCamera.from_field_of_view(width, height, np.radians(70.0))
    fitted = fit_width(camera, 64, 36)
    images, rows = fit_width_images(np.full((1, height, width, 3), 200, np.uint8), 64, 36)
    assert images.shape == (1, 36, 64, 3)
    assert degrees_across(fitted) == pytest.approx(degrees_across(camera.resized(64, 36)), abs=1e-9)
    assert (images[0, rows] == 200).all()
    assert (images[0, ~rows] == 0).all()
    assert rows.all() == (round(height * 64 / width) >= 36)


def test_lenses_are_told_apart_by_their_angles():
    lens = NAMED.camera
    assert is_lens_of(lens, lens)
    assert not is_lens_of(PinholeCamera.from_field_of_view(WIDTH, HEIGHT, np.radians(116.0)), lens)
    assert not is_lens_of(lens.redrawn(WIDTH, HEIGHT, (1.3, 1.3), (lens.cx, lens.cy)), lens)
    beyond = lens.redrawn(WIDTH, HEIGHT, (0.2, 0.2), (lens.cx, lens.cy))  # columns that the lens does not reach
    assert not is_lens_of(beyond, lens)


@given(st.integers(0, 2**30 - 1))
def test_the_largest_rectangle_is_full_and_none_is_larger(bits):
    mask = np.array([bits >> place & 1 for place in range(30)], bool).reshape(5, 6)
    rows, columns = largest_rectangle(mask)
    area = mask[rows, columns].size
    assert mask[rows, columns].all()
    largest = max(
        (bottom - top) * (right - left)
        for top in range(5)
        for bottom in range(top, 6)
        for left in range(6)
        for right in range(left, 7)
        if mask[top:bottom, left:right].all()
    )
    assert area == largest
