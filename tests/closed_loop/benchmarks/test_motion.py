"""Errors of recovered motion against what is stated of them: each verdict on estimates that are made up."""

import json
from dataclasses import replace

import numpy as np
import pytest

from olt_closed_loop.benchmarks.motion_errors import ClipErrors, MeasuredClip, measure_motion
from olt_closed_loop.benchmarks.motion_tables import count_reasons, draw_scale_errors, summarize, write_sheet
from olt_generator.camera_spread import CameraSpread, Spread
from olt_generator.cameras import PinholeCamera
from olt_generator.doubts import Doubt
from olt_generator.errors import InputError
from olt_generator.motion.pose_sources import PoseEstimate
from olt_generator.motion.smoother import SmootherSettings
from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE
from olt_toolkit.runtime import command_line

TIMES = np.arange(0, 1_000_001, 100_000)
SPREAD = CameraSpread(Spread(0.03, "given"), Spread(0.04, "assumed"))


def record(positions: np.ndarray | None) -> Recording:
    reference = None if positions is None else Trajectory(TIMES, planar_pose(positions, 0.0, 0.0))
    camera = PinholeCamera.from_field_of_view(8, 4, 1.0)
    frames = np.zeros((len(TIMES), 4, 8, 3), dtype=np.uint8)
    return Recording(
        "clip", "test", frames, TIMES, camera, np.eye(4), DEFAULT_VEHICLE, reference=reference, spread=SPREAD
    )


def answer(positions: np.ndarray, sigma: float | None = 0.0, covariance: np.ndarray | None = None, doubts=()):
    trajectory = Trajectory(TIMES, planar_pose(positions, 0.0, 0.0))
    found = PoseEstimate(trajectory, np.eye(4), sigma, SmootherSettings(), covariance=covariance, doubts=doubts)
    return lambda recording: found


def measure(true: np.ndarray | None, found: np.ndarray, **stated) -> ClipErrors:
    return measure_motion(record(true), "made up", answer(found, **stated))


AHEAD = np.linspace(0.0, 10.0, len(TIMES))


def test_scale_error_is_held_against_all_that_is_stated() -> None:
    clip = measure(AHEAD, 1.1 * AHEAD, sigma=0.12)
    assert clip.log_scale_error == pytest.approx(np.log(1.1))
    assert clip.scale_sigma == pytest.approx(np.sqrt(0.12**2 + 0.03**2 + 0.04**2))
    assert clip.scale_z == pytest.approx(np.log(1.1) / 0.13)
    assert not clip.backwards and not clip.marked
    assert clip.ate_z is None, "no covariance is stated"


def test_backward_and_missing_motion_are_beyond_any_limit() -> None:
    for wrong in (-AHEAD, 0.0 * AHEAD):
        clip = measure(AHEAD, wrong, sigma=0.02)
        assert clip.backwards and clip.scale_z is None and clip.worst_z == float("inf")
    right = measure(-AHEAD, -AHEAD, sigma=0.02)
    assert not right.backwards and right.scale_z == pytest.approx(0.0)


def test_a_standstill_has_no_scale_but_positions() -> None:
    covariance = np.tile(np.diag([0.01, 0.0, 0.0, 0.0, 0.0, 0.0]), (len(TIMES), 1, 1))
    still = measure(0.0 * AHEAD, 0.0 * AHEAD, sigma=None, covariance=covariance)
    assert still.scale_z is None and not still.backwards
    assert (still.ate_sigma_m, still.ate_z) == (pytest.approx(0.1), 0.0)
    moved = measure(0.0 * AHEAD, 0.05 * AHEAD, sigma=0.0, covariance=covariance)
    assert moved.log_scale_error is None and moved.scale_z is None
    expected = np.sqrt(0.01 + 0.05**2 * np.mean((0.05 * AHEAD) ** 2))
    assert moved.ate_z == pytest.approx(np.sqrt(np.mean((0.05 * AHEAD) ** 2)) / expected)
    unknown = measure(0.0 * AHEAD, 0.05 * AHEAD, sigma=None, covariance=covariance)
    assert unknown.ate_z is None, "a motion of unknown scale promises nothing"


def test_the_promised_position_error_holds_shape_and_scale() -> None:
    covariance = np.tile(np.diag([0.03**2, 0.04**2, 0.0, 1.0, 1.0, 1.0]), (len(TIMES), 1, 1))
    clip = measure(AHEAD, AHEAD, sigma=0.12, covariance=covariance)
    assert clip.ate_sigma_m == pytest.approx(np.sqrt(0.05**2 + 0.13**2 * np.mean(AHEAD**2)))


def test_doubts_mark_and_refusals_are_kept() -> None:
    doubt = Doubt("speed", "the road is hidden in 40 of 60 frames")
    assert measure(AHEAD, AHEAD, doubts=(doubt,)).doubts == ("speed: the road is hidden in 40 of 60 frames",)
    doubted = replace(record(AHEAD), doubts=(doubt,))
    assert measure_motion(doubted, "made up", answer(AHEAD)).marked

    def refuse(recording: Recording) -> PoseEstimate:
        raise InputError("odometry: frame 12 shares only 3 usable points; cut it")

    clip = measure_motion(record(AHEAD), "made up", refuse)
    assert clip.refused is not None and not clip.marked and clip.worst_z is None


def test_what_has_no_reference_is_not_measured() -> None:
    clip = measure(None, AHEAD, sigma=0.02)
    assert clip.scale_sigma is not None
    assert (clip.scale_z, clip.ate_m, clip.worst_z, clip.reach_m) == (None, None, None, None)


def make_clips() -> list[ClipErrors]:
    def clip(kind: str, number: int, **values) -> ClipErrors:
        return ClipErrors(f"{kind}_{number}", kind, 50, 0.02, **values)

    return [
        clip("night", 0, scale_z=3.0, ate_m=1.0),
        clip("night", 1, scale_z=-1.0, ate_m=3.0),
        clip("night", 2, scale_z=9.0, ate_m=20.0, doubts=("speed: dark",)),
        clip("jam", 0, scale_z=-5.0, ate_m=2.0),
        clip("jam", 1, backwards=True, ate_m=8.0),
        clip("jam", 2, refused="odometry: frame 12 shares only 3 points; cut it"),
        clip("jam", 3, refused="odometry: frame 40 shares only 9 points; cut it"),
    ]


def test_the_table_counts_by_kind_and_over_all() -> None:
    night, jam, everything = summarize(make_clips())
    assert (night["kind"], night["clips"], night["marked"], night["refused"]) == ("night", 3, 1, 0)
    assert night["scale_z_rms"] == pytest.approx(np.sqrt(5.0))
    assert night["scale_z_rms_with_marked"] == pytest.approx(np.sqrt(91.0 / 3.0))
    assert night["beyond_limit_unmarked"] == 0 and night["worst_clip"] == "night_2"
    assert (jam["refused"], jam["beyond_limit_unmarked"], jam["backwards_unmarked"]) == (2, 2, 1)
    assert (
        jam["worst_clip"] == "jam_1"
        and jam["worst_clip_z"] is None
        and jam["worst_clip_backwards"]
        and jam["ate_m_worst"] == 8.0
    )
    assert (everything["kind"], everything["clips"], everything["beyond_limit_unmarked"]) == ("all", 7, 2)
    json.dumps(summarize(make_clips()), allow_nan=False)
    assert count_reasons(make_clips()) == {
        "refused": {"odometry: frame # shares only # points": 2},
        "marked": {"speed": 1},
    }


def test_pictures_are_written_whole(tmp_path) -> None:
    import cv2

    draw_scale_errors(tmp_path / "z.png", make_clips())
    thumbnails = np.full((3, 90, 160, 3), 128, dtype=np.uint8)
    write_sheet(tmp_path / "sheet.png", [MeasuredClip(clip, thumbnails) for clip in make_clips()], columns=2)
    assert cv2.imread(str(tmp_path / "sheet.png")).shape == (4 * 106, 2 * 480, 3)
    assert cv2.imread(str(tmp_path / "z.png")).std() > 5.0
    assert len(list(tmp_path.iterdir())) == 2


def test_nothing_to_measure_and_unknown_kinds_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert command_line.run(["bench", "motion", "--count", "0"]) == 1
    assert "--recording" in capsys.readouterr().err
    assert command_line.run(["bench", "motion", "--kinds", "fog"]) == 1
    assert "'fog'" in capsys.readouterr().err


@pytest.mark.slow
def test_a_clip_is_measured_the_same_at_any_number_of_workers(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    found = []
    for workers in ("1", "2"):
        options = ["--count", "2", "--kinds", "low_sun", "--workers", workers, "--cache", str(tmp_path), "--json"]
        assert command_line.run(["bench", "motion", *options]) == 0
        clips = json.loads(capsys.readouterr().out)["clips"]
        found.append([{key: value for key, value in clip.items() if key != "seconds_per_frame"} for clip in clips])
    assert found[0] == found[1]
    assert all(abs(clip["scale_z"]) < 6.0 for clip in found[0])
