"""`olt clip trajectory` on a ray-cast street."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import olt_toolkit.recordings.drives
from olt_generator.cameras import PinholeCamera
from olt_generator.doubts import Doubt
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


def read_tum(path):
    """Times in microseconds, positions and quaternions x, y, z, w, as the format is described elsewhere."""
    rows = [line.split(" ") for line in path.read_text().splitlines() if not line.startswith("#")]
    assert all(len(row) == 8 for row in rows)
    values = np.array(rows, dtype=np.float64)
    return np.rint(1e6 * values[:, 0]).astype(np.int64), values[:, 1:4], values[:, 4:]


def test_poses_are_written_for_other_tools(drive, tmp_path):
    files = {name: tmp_path / f"poses.{name}" for name in ("tum", "kitti", "parquet")}
    told = [json.loads(run(drive, "--out", path, "--json"))["poses"] for path in files.values()]
    assert [each["of"] for each in told] == ["rig", "camera", "rig"]
    times_us, positions, turns = read_tum(files["tum"])
    table = pq.read_table(files["parquet"])
    assert table["timestamp_us"].to_pylist() == times_us.tolist() == [100_000 * index for index in range(21)]
    columns = np.stack([table[name].to_numpy() for name in ("x", "y", "z", "qx", "qy", "qz", "qw")], axis=1)
    assert np.abs(columns - np.concatenate([positions, turns], axis=1)).max() < 1e-8
    assert columns[0] == pytest.approx([0, 0, 0, 0, 0, 0, 1], abs=1e-9)
    # The camera goes along its own z axis, which points ahead and a little down, and turns left about its -y axis.
    camera = np.loadtxt(files["kitti"]).reshape(-1, 3, 4)
    assert camera.shape == (21, 3, 4)
    assert camera[-1, 2, 3] == pytest.approx(positions[-1, 0], rel=0.01)
    rig_turn = Rotation.from_quat(turns[-1]).magnitude()
    assert Rotation.from_matrix(camera[-1, :, :3]).as_rotvec() == pytest.approx([0.0, -rig_turn, 0.0], abs=5e-3)


def test_metadata_tell_conventions_and_what_is_not_known(drive, tmp_path):
    path = tmp_path / "poses.parquet"
    run(drive, "--out", path)
    table = pq.read_table(path)
    told = json.loads(table.schema.metadata[b"olt_trajectory"])
    assert (told["version"], told["poses_of"], told["recording"]) == (1, "rig", "street")
    assert told["axes"].startswith("x forward, y left, z up")
    assert (told["covariance"] == "not known") == ("covariance" not in table.column_names)
    assert told["scale_sigma"]["height"] == {"relative": 0.01, "origin": "calibrated"}
    first = path.read_bytes()
    run(drive, "--out", path)
    assert path.read_bytes() == first


def test_clips_have_a_file_each(drive, tmp_path):
    result = json.loads(run(drive, "--clip-frames", 11, "--stride", 10, "--out", tmp_path / "poses.tum", "--json"))
    assert [Path(name).name for name in result["poses"]["files"]] == ["poses_000000.tum", "poses_000010.tum"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["poses_000000.tum", "poses_000010.tum"]
    times_us, positions, _ = read_tum(tmp_path / "poses_000010.tum")
    assert (times_us[0], len(times_us)) == (1_000_000, 11)
    assert (positions[0] == 0.0).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "poses.txt"], r"poses.txt: .txt tells no format of poses; use .tum, .kitti, .parquet, or --format"),
        (["--of", "camera"], "no poses are written without --out"),
        (["--format", "tum"], "no poses are written without --out"),
    ],
)
def test_poses_without_a_format_or_a_file_are_refused_before_any_work(tmp_path, options, message):
    with pytest.raises(InputError, match=message):
        run(tmp_path / "is_not_opened.mp4", *options)


def test_any_extension_takes_a_format_that_is_named(drive, tmp_path):
    run(drive, "--out", tmp_path / "poses.txt", "--format", "kitti", "--of", "rig")
    assert np.loadtxt(tmp_path / "poses.txt").shape == (21, 12)


def test_what_is_known_is_printed_and_what_is_not_is_said(drive):
    printed = run(drive)
    assert "scale of the clip from frame 0: 1 sigma" in printed
    assert "height 1.00 % (calibrated), focal length 0.30 % (calibrated)" in printed
    assert "not known" in printed
    result = json.loads(run(drive, "--json"))["clips"][0]
    assert result["scale_z"] == pytest.approx(result["scale_error"] / result["scale_sigma"])
    assert abs(result["scale_z"]) < 4.0
    assert result["smoothness_of_reference_smoothed"]["acceleration_variance_m2_s4"] is not None


def test_what_is_in_doubt_is_printed(drive, monkeypatch):
    assert "nothing is in doubt" in run(drive)
    doubtful = replace(
        olt_toolkit.recordings.drives.open_recording(drive, None, None),
        doubts=(Doubt("view direction", "the file is called rear"),),
    )
    monkeypatch.setattr(olt_toolkit.recordings.drives, "open_recording", lambda path, options, cache: doubtful)
    printed = run(drive)
    assert "in doubt, clip from frame 0: view direction: the file is called rear" in printed
    assert "nothing is in doubt" not in printed
