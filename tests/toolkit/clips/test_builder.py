from dataclasses import replace

import cv2
import numpy as np
import pytest

from olt_generator.camera_spread import CameraSpread, Spread
from olt_generator.cameras import PinholeCamera, pixel_rays
from olt_generator.doubts import Doubt
from olt_generator.errors import InputError
from olt_generator.motion.pose_sources import PoseEstimate
from olt_generator.motion.smoother import ODOMETRY_SETTINGS
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_generator.views.pixel_origin import PixelOrigin
from olt_generator.views.view_plan import METHODS
from olt_toolkit.clips.builder import BuildOptions, build_clip
from olt_toolkit.clips.files import describe_clip
from olt_toolkit.clips.summary import summarize_build
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import (
    CROSS_LEFT,
    CROSS_RIGHT,
    DEFAULT_VEHICLE,
    FRONT_TELE,
    FRONT_WIDE,
    POLICY_CAMERAS,
    MountedCamera,
)
from olt_toolkit.rigs.rig_files import pav_rig

SIZE = (192, 108)
OPTIONS = BuildOptions(width=128, height=72)
SIDES = (CROSS_LEFT, CROSS_RIGHT)
STREET_HALF_WIDTH = 7.0


class Street:
    """A straight street between two endless walls, each surface with its own random pattern of 40 cm grain."""

    def __init__(self):
        noise = make_generator("street").normal(size=(3, 512, 512, 3))
        blurred = [cv2.GaussianBlur(each, (0, 0), 4.0) for each in noise]
        self._textures = [np.clip(128 + 50 * each / each.std(), 0, 255).astype(np.uint8) for each in blurred]

    def render(self, camera, T_world_camera):
        """Image (H, W, 3) and distance (H, W) along the rays, inf in the sky."""
        rays = pixel_rays(camera) @ T_world_camera[:3, :3].T
        origin = T_world_camera[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            to_planes = np.stack(
                [
                    -origin[2] / rays[..., 2],
                    (STREET_HALF_WIDTH - origin[1]) / rays[..., 1],
                    (-STREET_HALF_WIDTH - origin[1]) / rays[..., 1],
                ]
            )
        to_planes[~(to_planes > 0)] = np.inf
        # The walls are 8 m high.
        above = origin[2] + to_planes[1:] * rays[..., 2] > 8.0
        to_planes[1:][above] = np.inf
        surface, distance = to_planes.argmin(axis=0), to_planes.min(axis=0)
        points = origin + np.where(np.isfinite(distance), distance, 0.0)[..., None] * rays
        image = np.full((*distance.shape, 3), 200, np.uint8)
        for index, axes in enumerate([(0, 1), (0, 2), (0, 2)]):
            here = (surface == index) & np.isfinite(distance)
            cells = np.floor(points[..., axes] * 10.0).astype(int) % 512
            image[here] = self._textures[index][cells[..., 0], cells[..., 1]][here]
        return image, distance.astype(np.float32)


@pytest.fixture(scope="module")
def recording():
    """Three seconds at 10 Hz and 6 m/s down the street, with everything about it known."""
    street, camera = Street(), PinholeCamera.from_field_of_view(*SIZE, np.radians(70.0))
    T_rig_camera = camera_pose_in_rig([1.7, 0.0, 1.5], 0.0, 0.02, 0.0)
    timestamps_us = 100_000 * np.arange(31, dtype=np.int64)
    reference = Trajectory(timestamps_us, planar_pose(6.0 * timestamps_us * 1e-6, 0.0, 0.0))
    rendered = [street.render(camera, pose @ T_rig_camera) for pose in reference.T_world_rig]
    rig = pav_rig().fitted(OPTIONS.width, OPTIONS.height)
    views = {
        name: np.stack([street.render(rig[name].camera, T @ rig[name].T_rig_camera)[0] for T in reference.T_world_rig])
        for name in (*SIDES, FRONT_TELE)
    }
    return Recording(
        name="street",
        source="test",
        frames=np.stack([image for image, _ in rendered]),
        timestamps_us=timestamps_us,
        camera=camera,
        T_rig_camera=T_rig_camera,
        vehicle=DEFAULT_VEHICLE,
        assumptions=("the street is endless",),
        reference=reference,
        distance=np.stack([distance for _, distance in rendered]),
        views=views,
    )


@pytest.fixture(scope="module")
def built(recording):
    """The clip with synthesized views along the known motion."""
    return build_clip(recording, replace(OPTIONS, use_reference_motion=True))


def left_out_of(built):
    """How many of how many were not made, by what they are."""
    return {omission.what: (omission.count, omission.total) for omission in built.left_out}


def test_four_streams_of_one_size_and_time(built, recording):
    clip = built.clip
    assert clip.kind == "Syn"
    assert tuple(clip.streams) == POLICY_CAMERAS
    for stream in clip.streams.values():
        assert stream.frames.shape == (31, 72, 128, 3)
        assert (stream.camera.width, stream.camera.height) == (128, 72)
        assert stream.frame_rate == 10.0
        np.testing.assert_array_equal(stream.timestamps_us, recording.timestamps_us)


def test_provenance_says_what_was_seen(built):
    assert {name: view.kind for name, view in built.clip.provenance.items()} == {
        CROSS_LEFT: "warped",
        FRONT_WIDE: "observed",
        CROSS_RIGHT: "warped",
        FRONT_TELE: "cropped",
    }
    for name in SIDES:
        view = built.clip.provenance[name]
        origin = built.clip.streams[name].origin
        assert view.observed_share == pytest.approx((origin != PixelOrigin.INVENTED).mean())
        assert view.other_times_share == pytest.approx((origin == PixelOrigin.OTHER_FRAME).mean())
        assert view.observed_share + view.invented_share == pytest.approx(1.0)
        assert view.unseen_share == 0.0
        assert 0.02 < view.observed_share < 0.7
    assert built.clip.origins.keys() == {*SIDES, FRONT_WIDE}


def test_what_was_seen_is_closer_to_the_truth_than_what_was_invented(built):
    for name in SIDES:
        assert built.view_errors[name]["psnr_observed"] > built.view_errors[name]["psnr"] > 5.0


def test_errors_that_cannot_be_measured_are_none(built, recording):
    assert built.distance_error is not None
    assert built.distance_error < 0.5
    assert built.motion is None
    unknown = replace(recording, distance=None, views={})
    blind = build_clip(unknown, replace(OPTIONS, use_reference_motion=True, cameras=(FRONT_WIDE, CROSS_LEFT)))
    assert blind.distance_error is None
    assert blind.view_errors == {}


def test_true_views_are_taken_as_they_are(recording):
    built = build_clip(recording, replace(OPTIONS, use_reference_views=True, image_kind="rendered"))
    assert built.clip.kind == "GT"
    assert {view.kind for view in built.clip.provenance.values()} == {"rendered"}
    for name in (*SIDES, FRONT_TELE):
        np.testing.assert_array_equal(built.clip.streams[name].frames, recording.views[name])
    assert left_out_of(built)["distances of front frames"] == (31, 31)
    assert built.clip.origins == {}
    assert built.seconds.keys() == {"views"}
    np.testing.assert_allclose(built.clip.ego_motion.velocity, [[6.0, 0.0, 0.0]] * 31, atol=1e-9)


def test_true_views_may_have_lenses_of_their_own_and_be_mosaics(recording):
    """Of cross-left the right half is seen; cross-right is a whole true view of the vehicle's own camera."""
    rig = pav_rig().fitted(OPTIONS.width, OPTIONS.height)
    lens = rig[CROSS_RIGHT].camera
    shifted = lens.redrawn(128, 72, (1.0, 1.0), (lens.cx + 2.0, lens.cy))
    own = MountedCamera(shifted, camera_pose_in_rig([2.0, -1.0, 1.0], 0.0, 0.0, -1.1))
    mask = np.zeros((72, 128), bool)
    mask[:, 64:] = True
    partly = replace(recording, mounted={CROSS_RIGHT: own}, observed={CROSS_LEFT: mask})
    clip = build_clip(partly, replace(OPTIONS, use_reference_views=True)).clip
    provenance = clip.provenance[CROSS_LEFT]
    assert (provenance.kind, provenance.observed_share, provenance.unseen_share) == ("mosaic", 0.5, 0.5)
    assert provenance.invented_share == 0.0
    expected = np.where(mask, PixelOrigin.SAME_FRAME, PixelOrigin.UNSEEN)
    np.testing.assert_array_equal(clip.streams[CROSS_LEFT].origin, np.broadcast_to(expected, (31, 72, 128)))
    assert clip.provenance[CROSS_RIGHT].kind == "observed"
    assert clip.streams[CROSS_RIGHT].camera == own.camera
    np.testing.assert_array_equal(clip.streams[CROSS_RIGHT].T_rig_camera, own.T_rig_camera)
    assert clip.streams[CROSS_LEFT].camera == rig[CROSS_LEFT].camera


def test_a_mosaic_of_the_front_goes_before_the_front_images(recording):
    wide = {**recording.views, FRONT_WIDE: np.full((31, 72, 128, 3), 77, np.uint8)}
    seen = {FRONT_WIDE: np.ones((72, 128), bool)}
    clip = build_clip(replace(recording, views=wide, observed=seen), replace(OPTIONS, use_reference_views=True)).clip
    assert clip.provenance[FRONT_WIDE].kind == "mosaic"
    assert clip.streams[FRONT_WIDE].frames.min() == clip.streams[FRONT_WIDE].frames.max() == 77
    assert clip.streams[FRONT_WIDE].camera == pav_rig().fitted(128, 72)[FRONT_WIDE].camera


def test_errors_are_measured_only_against_the_same_view_and_all_of_it(recording):
    """One true view is a mosaic, the other was taken with another lens; motion may be known beyond the images."""
    rig = pav_rig().fitted(OPTIONS.width, OPTIONS.height)
    lens = rig[CROSS_RIGHT].camera
    other = MountedCamera(lens.redrawn(128, 72, (1.0, 1.0), (lens.cx + 2.0, lens.cy)), rig[CROSS_RIGHT].T_rig_camera)
    times = 100_000 * np.arange(-10, 41, dtype=np.int64)
    partly = replace(
        recording,
        frames=recording.frames[:4],
        timestamps_us=recording.timestamps_us[:4],
        distance=recording.distance[:4],
        views={name: images[:4] for name, images in recording.views.items()},
        mounted={CROSS_RIGHT: other},
        observed={CROSS_LEFT: np.ones((72, 128), bool)},
        reference=Trajectory(times, planar_pose(6.0 * times * 1e-6, 0.0, 0.0)),
    )
    built = build_clip(partly, replace(OPTIONS, use_reference_motion=True))
    assert built.view_errors == {}
    assert built.clip.ego_motion.span_us == (-1_000_000, 4_000_000)
    own = replace(partly, mounted={name: rig[name] for name in SIDES}, observed={})
    kept = build_clip(own, replace(OPTIONS, use_reference_motion=True))
    assert kept.view_errors.keys() == set(SIDES)


def test_motion_is_measured_where_it_is_not_given(recording):
    stages, shares = [], []
    built = build_clip(recording, OPTIONS, shares.append, stages.append)
    assert built.motion.errors is not None
    assert built.motion.measured_errors is not None
    travelled = built.clip.ego_motion.trajectory.path_length
    assert travelled == pytest.approx(18.0, rel=0.2)
    np.testing.assert_allclose(built.clip.ego_motion.trajectory.positions[0], 0.0, atol=1e-9)
    assert stages == ["odometry", "smoothing", "distance", "views"]
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)
    assert built.seconds.keys() == set(stages)


def test_doubts_and_uncertainty_reach_the_clip(recording):
    true = recording.reference
    doubt = Doubt("speed", "two ways of measuring it differ by 30 %")
    found = PoseEstimate(
        true,
        recording.T_rig_camera,
        0.03,
        ODOMETRY_SETTINGS,
        covariance=np.tile(1e-4 * np.eye(6), (len(true), 1, 1)),
        doubts=(doubt,),
    )
    options = replace(OPTIONS, cameras=(FRONT_WIDE, FRONT_TELE), poses=lambda *_: found)
    seen = Doubt("view direction", "the file is called rear")
    spread = CameraSpread(Spread(0.04, "assumed"), Spread(0.0, "given"))
    built = build_clip(replace(recording, doubts=(seen,), spread=spread), options)
    assert built.doubts == (seen, doubt)
    assert built.clip.doubts == ("view direction", "speed")
    assert built.clip.scale_sigma == pytest.approx(0.05)
    # At 18 m the scale alone is off by 0.9 m.
    assert np.sqrt(built.motion.covariance[-1, 0, 0]) == pytest.approx(np.hypot(0.05 * 18.0, 0.01), rel=1e-3)
    info = describe_clip(built.clip, "")
    summary = summarize_build(built, info)
    assert summary["doubts"] == [{"what": each.what, "why": each.why} for each in (seen, doubt)]
    assert summary["scale_sigma_parts"]["height"] == {"relative": 0.04, "origin": "assumed"}
    assert summary["clip"]["doubts"] == ["view direction", "speed"]
    given = build_clip(replace(recording, doubts=(seen,)), replace(options, use_reference_motion=True))
    assert (given.clip.doubts, given.clip.scale_sigma) == (("view direction",), None)


def test_what_is_not_wanted_is_left_out_and_changes_nothing(built, recording):
    front = build_clip(recording, replace(OPTIONS, use_reference_motion=True, cameras=(FRONT_WIDE, FRONT_TELE)))
    assert front.clip.kind == "front_only"
    assert left_out_of(front)["distances of front frames"] == (31, 31)
    assert left_out_of(front).keys() >= set(SIDES)
    for name, stream in front.clip.streams.items():
        np.testing.assert_array_equal(stream.frames, built.clip.streams[name].frames)


@pytest.mark.parametrize("alone", ["camera_rear_tele_30fov", CROSS_LEFT])
def test_a_view_is_the_same_alone_as_with_all_others(recording, alone):
    """The recording played at 30 Hz, where views look back to frames that are not made."""
    times = recording.timestamps_us // 3
    fast = replace(recording, timestamps_us=times, reference=Trajectory(times, recording.reference.T_world_rig))
    single, all_ = (
        build_clip(fast, replace(OPTIONS, use_reference_motion=True, cameras=cameras)).clip
        for cameras in ((alone,), tuple(METHODS))
    )
    assert list(single.streams) == [alone]
    np.testing.assert_array_equal(single.streams[alone].frames, all_.streams[alone].frames)
    assert single.provenance[alone] == all_.provenance[alone]


def test_frames_that_no_sample_shows_are_left_out_and_change_nothing(recording):
    """The recording played at 30 Hz: one frame in three is made, and that is the same as with all of them."""
    times = recording.timestamps_us // 3
    fast = replace(recording, timestamps_us=times, reference=Trajectory(times, recording.reference.T_world_rig))
    cameras = (FRONT_WIDE, CROSS_LEFT)
    some, every = (
        build_clip(fast, replace(OPTIONS, use_reference_motion=True, cameras=cameras, frames=frames))
        for frames in ("grid", "all")
    )
    assert left_out_of(some)["frames of each view"] == (20, 31)
    for name in cameras:
        few, all_ = some.clip.streams[name], every.clip.streams[name]
        assert len(few.frames) == len(few.timestamps_us) == 11
        assert few.frame_rate == 10.0
        assert all_.frame_rate == 30.0
        shown = np.isin(all_.timestamps_us, few.timestamps_us)
        np.testing.assert_array_equal(few.frames, all_.frames[shown])
    assert len(some.clip.ego_motion.trajectory) == 31


def test_sampled_frames_give_all_samples_of_the_clip(recording):
    """The recording played at 2.5 Hz lasts 12 s; samples show 1.2 to 5.6 s of it."""
    times = recording.timestamps_us * 4
    slow = replace(recording, timestamps_us=times, reference=Trajectory(times, recording.reference.T_world_rig))
    some, every = (
        build_clip(slow, replace(OPTIONS, use_reference_motion=True, frames=frames)) for frames in ("sampled", "grid")
    )
    kept_us = some.clip.streams[CROSS_LEFT].timestamps_us
    assert (kept_us[0], kept_us[-1]) == (1_200_000, 5_600_000)
    assert describe_clip(some.clip, "").sample_t0_us == describe_clip(every.clip, "").sample_t0_us
    assert left_out_of(some)["distances of front frames"][0] > 0
    assert "distances of front frames" not in left_out_of(every)
    assert left_out_of(some)["frames of each view"] == (19, 31)


def test_the_same_recording_gives_the_same_clip(built, recording):
    again = build_clip(recording, replace(OPTIONS, use_reference_motion=True))
    assert again.clip.clip_id == built.clip.clip_id
    for name, stream in again.clip.streams.items():
        np.testing.assert_array_equal(stream.frames, built.clip.streams[name].frames)
    other = build_clip(recording, replace(OPTIONS, seed=1, use_reference_views=True))
    assert other.clip.clip_id != built.clip.clip_id


def test_irregular_times_are_kept_at_a_nominal_rate(recording):
    times = recording.timestamps_us * 1034 // 1000
    slow = replace(recording, timestamps_us=times, reference=Trajectory(times, recording.reference.T_world_rig))
    stream = build_clip(slow, replace(OPTIONS, use_reference_views=True)).clip.streams[FRONT_WIDE]
    assert stream.frame_rate == 10.0
    np.testing.assert_array_equal(stream.timestamps_us, times)


def test_an_inexact_lens_is_said_so(recording):
    wide = replace(recording, camera=PinholeCamera.from_field_of_view(*SIZE, np.radians(105.0)))
    built = build_clip(wide, replace(OPTIONS, use_reference_views=True))
    assert built.assumptions[0] == "the street is endless"
    assert any(FRONT_WIDE in note and "polynomials" in note for note in built.assumptions)


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({"reference": None}, {"use_reference_motion": True}, "true trajectory is not known"),
        ({"views": {}}, {"use_reference_views": True}, "no true images of camera_cross_left_120fov"),
        ({}, {"cameras": ("camera_roof",)}, "camera_roof"),
    ],
)
def test_what_cannot_be_built_is_refused(recording, change, options, message):
    with pytest.raises(InputError, match=message):
        build_clip(replace(recording, **change), replace(OPTIONS, **options))


def test_odd_sizes_are_refused():
    with pytest.raises(InputError, match="must be even"):
        BuildOptions(width=127, height=72)


def test_rear_views_are_made_by_looking_back(recording):
    rear = "camera_rear_left_70fov"
    options = replace(OPTIONS, use_reference_motion=True, cameras=(FRONT_WIDE, rear))
    built = build_clip(recording, options)
    assert built.plan.methods == {FRONT_WIDE: "given", rear: "synthesized"}
    assert {omission.what for omission in built.plan.left_out} == {
        *(CROSS_LEFT, CROSS_RIGHT, FRONT_TELE, "camera_rear_right_70fov", "camera_rear_tele_30fov")
    }
    view = built.clip.provenance[rear]
    assert view.observed_share == view.other_times_share > 0.02
    assert (
        built.clip.streams[rear].origin[0] == PixelOrigin.INVENTED
    ).all()  # at first there is nothing to look back to
    drawn_on, count = left_out_of(built)["other front frames of the synthesized images"]
    assert 0 < drawn_on < count
