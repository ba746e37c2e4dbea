"""`olt clip trajectory` on a ray-cast street."""

import json

import pytest
from typer.testing import CliRunner

import olt_toolkit.recordings.drives
from olt_generator.cameras import PinholeCamera
from olt_generator.errors import InputError
from olt_toolkit.benchmarks.odometry import CAMERA, MOUNTING, make_drive
from olt_toolkit.commands.clip import app
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE


@pytest.fixture
def drive(monkeypatch, tmp_path):
    frames, reference = make_drive()
    assert isinstance(CAMERA, PinholeCamera)
    recording = Recording(
        "street", "test", frames, reference.timestamps_us, CAMERA, MOUNTING, DEFAULT_VEHICLE, reference=reference
    )
    monkeypatch.setattr(olt_toolkit.recordings.drives, "open_recording", lambda path, options, cache: recording)
    return tmp_path / "street.drive"


def run(*arguments):
    result = CliRunner().invoke(app, ["trajectory", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0
    return result.stdout


def test_clips_are_measured_and_drawn(drive, tmp_path):
    picture = tmp_path / "motion.png"
    result = json.loads(run(drive, "--clip-frames", 11, "--stride", 10, "--picture", picture, "--json"))
    assert [clip["first_frame"] for clip in result["clips"]] == [0, 10]
    assert result["summary"]["clips"] == 2
    assert 0.0 < result["summary"]["mean_ate_m"] < 0.3
    assert result["summary"]["worst_ate_m"] == max(clip["errors"]["metric"]["ate_m"] for clip in result["clips"])
    assert all(clip["jerk_factor"] > 1.0 for clip in result["clips"])
    assert all(clip["label_noise"] is None for clip in result["clips"])
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_recording_shorter_than_a_clip_is_refused(drive):
    with pytest.raises(InputError, match="has 21 frames, a clip needs 41"):
        run(drive, "--clip-frames", 41)


def test_smoothing_takes_jitter_out_of_the_reference(drive):
    result = json.loads(run(drive, "--jitter-m", 0.05, "--jitter-deg", 0.1, "--json"))
    (clip,) = result["clips"]
    raw, smoothed = (clip[name]["metric"]["ate_m"] for name in ("errors_before_smoothing", "errors"))
    assert smoothed < raw
    assert clip["jerk_factor"] > 100.0
    assert clip["acceleration_variance_factor"] > 100.0
    assert clip["scale_sigma"] is None
