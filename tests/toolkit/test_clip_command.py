import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import olt_toolkit.recording
from olt_generator.cameras import PinholeCamera
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_toolkit.clip import make_clip_id
from olt_toolkit.clip_store import ClipStore
from olt_toolkit.commands.clip import app
from olt_toolkit.recording import Recording
from olt_toolkit.rig import CROSS_LEFT, DEFAULT_VEHICLE, POLICY_CAMERAS


@pytest.fixture
def source(monkeypatch):
    """A reader whose recording is the same still picture again and again; keeps the options that it was given."""
    image = make_generator("picture").integers(0, 256, (54, 96, 3)).astype(np.uint8)
    timestamps_us = 100_000 * np.arange(30, dtype=np.int64)
    recording = Recording(
        name="drive",
        source="test",
        frames=np.repeat(image[None], 30, axis=0),
        timestamps_us=timestamps_us,
        camera=PinholeCamera.from_field_of_view(96, 54, np.radians(60.0)),
        T_rig_camera=camera_pose_in_rig([1.5, 0.0, 1.4], 0.0, 0.0, 0.0),
        vehicle=DEFAULT_VEHICLE,
        assumptions=("lens: 60 degrees",),
        reference=Trajectory(timestamps_us, np.repeat(planar_pose(0.0, 0.0, 0.0)[None], 30, axis=0)),
    )

    class Reader:
        name = "test"
        options = None

        def recognises(self, path: Path) -> bool:
            return path.suffix == ".drive"

        def open(self, path, options):
            self.options = options
            return replace(recording, name=path.stem)

    reader = Reader()

    class Entry:
        name = "test"

        def load(self):
            return reader

        def __lt__(self, other):
            return False

    monkeypatch.setattr(olt_toolkit.recording, "entry_points", lambda group: [Entry()])
    return reader


@pytest.fixture
def drive(tmp_path, source):
    path = tmp_path / "town.drive"
    path.write_text("")
    return path


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=True)


def build(drive, *arguments):
    return run("build", drive, "--width", 96, "--height", 54, *arguments)


def test_build_writes_clip_and_pictures(tmp_path, drive, source):
    store = tmp_path / "clips"
    result = build(drive, "--out", store, "--json", "--fov", 50, "--camera-height", 1.2, "--duration", 3)
    assert result.exit_code == 0, result.output
    assert source.options.horizontal_fov == pytest.approx(np.radians(50.0))
    assert (source.options.camera_height, source.options.duration) == (1.2, 3.0)
    summary = json.loads(result.stdout)
    assert summary["clip"]["kind"] == "Syn"
    assert summary["clip"]["name"] == "town"
    assert set(summary["clip"]["views"]) == set(POLICY_CAMERAS)
    assert summary["trajectory"]["length"] == pytest.approx(0.0, abs=0.5)
    assert summary["pose_errors"] is not None
    assert summary["distance_median_relative_error"] is None
    assert summary["assumptions"][0] == "lens: 60 degrees"
    assert set(summary["left_out"]) == {
        "camera_rear_left_70fov",
        "camera_rear_right_70fov",
        "camera_rear_tele_30fov",
    }
    assert "6.4 s of future" in summary["clip"]["no_sample_reason"]
    assert Path(summary["preview"]) == store / "previews" / "town.png"
    assert Path(summary["preview"]).is_file()
    info = ClipStore(store).info(summary["clip"]["clip_id"])
    assert info.views[CROSS_LEFT].kind == "warped"


def test_build_prints_what_was_measured_and_what_not(tmp_path, drive):
    result = build(drive, "--out", tmp_path / "clips", "--name", "night")
    assert result.exit_code == 0, result.output
    for part in ("clip night (Syn)", "not measured", "left out: camera_rear_tele_30fov", "assumed: lens", "no policy"):
        assert part in result.stdout


def test_the_same_clip_is_not_built_twice(tmp_path, drive):
    assert build(drive, "--out", tmp_path / "clips").exit_code == 0
    again = build(drive, "--out", tmp_path / "clips")
    assert isinstance(again.exception, InputError)
    assert "already holds the clip 'town'" in str(again.exception)
    assert build(drive, "--out", tmp_path / "clips", "--seed", 1).exit_code == 0
    assert len(ClipStore(tmp_path / "clips").clips()) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--name", "a/b"), "without slashes"),
        (("--width", 95), "must be even"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_written(tmp_path, drive, arguments, message):
    result = build(drive, "--out", tmp_path / "clips", *arguments)
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)
    assert not (tmp_path / "clips" / "clips.parquet").exists()


def test_missing_input_and_unusable_output_are_refused(tmp_path, drive):
    missing = build(tmp_path / "nowhere.drive", "--out", tmp_path / "clips")
    assert "no such file or folder" in str(missing.exception)
    unusable = build(drive, "--out", drive / "clips")
    assert isinstance(unusable.exception, InputError)
    assert "choose another output folder" in str(unusable.exception)


def test_interrupted_build_leaves_nothing_and_the_next_one_completes(tmp_path, drive, monkeypatch):
    def interrupt(*_args, **_options):
        raise KeyboardInterrupt

    store = tmp_path / "clips"
    with monkeypatch.context() as patch:
        patch.setattr("olt_toolkit.clip_files.write_video", interrupt)
        assert build(drive, "--out", store).exit_code != 0
    assert [path for path in store.rglob("*") if path.is_file()] == []
    assert build(drive, "--out", store).exit_code == 0


@pytest.fixture
def store(tmp_path, make_clip):
    store = ClipStore(tmp_path / "clips")
    store.stage(make_clip("bend"))
    store.commit([make_clip_id("bend")])
    return store


def test_inspect_lists_clips(store):
    result = run("inspect", store.root, "--json")
    assert [clip["name"] for clip in json.loads(result.stdout)["clips"]] == ["bend"]
    assert "9, t0 = 1.7 to 2.5 s" in run("inspect", store.root).stdout


def test_inspect_shows_one_clip(store):
    clip_id = make_clip_id("bend")
    summary = json.loads(run("inspect", store.root, clip_id, "--json").stdout)
    assert summary["trajectory"]["mean_speed"] == pytest.approx(8.0, rel=1e-3)
    assert summary["cameras"][CROSS_LEFT] == {
        "size": [128, 72],
        "position_rig": pytest.approx([2.473, 0.938, 0.918]),
        "frames": 90,
        "first_us": 0,
        "last_us": 8_900_000,
    }
    text = run("inspect", store.root, clip_id).stdout
    assert "clip bend (GT, nominal, train)" in text
    assert "0.00 to 8.90 s" in text


def test_inspect_names_what_is_missing(store, tmp_path):
    assert "not a clip store" in str(run("inspect", tmp_path).exception)
    assert "no clip" in str(run("inspect", store.root, make_clip_id("other")).exception)
