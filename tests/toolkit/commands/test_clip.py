import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import olt_toolkit.recordings.drives
from olt_generator.cameras import PinholeCamera
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_generator.video import read_video
from olt_toolkit.clips.clip import make_clip_id
from olt_toolkit.clips.origin_files import decode_origin
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.commands.clip import app
from olt_toolkit.recordings.drives import WHOLE, Drive
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.contracts import find_contract
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, DEFAULT_VEHICLE, FRONT_WIDE, POLICY_CAMERAS

FRAMES = 10


@pytest.fixture
def source(monkeypatch):
    """A reader whose recording is the same still picture again and again; keeps the options that it was given."""
    image = make_generator("picture").integers(0, 256, (54, 96, 3)).astype(np.uint8)
    timestamps_us = 100_000 * np.arange(FRAMES, dtype=np.int64)
    recording = Recording(
        name="drive",
        source="test",
        frames=np.repeat(image[None], FRAMES, axis=0),
        timestamps_us=timestamps_us,
        camera=PinholeCamera.from_field_of_view(96, 54, np.radians(60.0)),
        T_rig_camera=camera_pose_in_rig([1.5, 0.0, 1.4], 0.0, 0.0, 0.0),
        vehicle=DEFAULT_VEHICLE,
        assumptions=("lens: 60 degrees",),
        reference=Trajectory(timestamps_us, np.repeat(planar_pose(0.0, 0.0, 0.0)[None], FRAMES, axis=0)),
    )

    class Reader:
        name = "test"
        licence = None
        options = None

        def recognises(self, path: Path) -> bool:
            return path.suffix.lower() == ".drive"

        def open(self, path, cache):
            return OneDrive(path)

        def record(self, path, options):
            self.options = options
            return replace(recording, name=path.stem)

    class OneDrive:
        source = "test"

        def __init__(self, path):
            self.path = path

        def keys(self):
            return [WHOLE]

        def drive(self, key):
            scene_id, times_us = f"test/{self.path.name}", recording.timestamps_us
            return Drive("test", scene_id, key, times_us, ("front",), (0, int(times_us[-1])), (FRONT_WIDE,))

        def open(self, key, window_us, options):
            return reader.record(self.path, options)

    reader = Reader()
    monkeypatch.setattr(olt_toolkit.recordings.drives, "readers", lambda: {reader.name: reader})
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
    assert {omission["what"] for omission in summary["left_out"]} >= {
        "camera_rear_left_70fov",
        "camera_rear_right_70fov",
        "camera_rear_tele_30fov",
    }
    assert "6.4 s of future" in summary["clip"]["no_sample_reason"]
    called = f"town-{summary['clip']['clip_id'][:8]}"
    for path in (store / "previews" / f"{called}.png", store / "previews" / f"{called}.webp"):
        assert str(path) in summary["pictures"].values()
        assert path.is_file()
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


@pytest.mark.slow
def test_label_noise_is_measured_where_there_are_labels(tmp_path, drive, source, monkeypatch):
    def open_longer(path, options):
        short = type(source).record(source, path, options)
        timestamps_us = 100_000 * np.arange(85, dtype=np.int64)
        standing = Trajectory(timestamps_us, np.repeat(short.reference.T_world_rig[:1], 85, axis=0))
        frames = np.repeat(short.frames[:1], 85, axis=0)
        return replace(short, frames=frames, timestamps_us=timestamps_us, reference=standing)

    assert json.loads(build(drive, "--out", tmp_path / "short", "--json").stdout)["label_noise"] is None
    monkeypatch.setattr(source, "record", open_longer)
    result = build(drive, "--out", tmp_path / "clips", "--json")
    noise = json.loads(result.stdout)["label_noise"]
    assert noise["samples"] > 0
    assert 0.0 <= noise["actual"]["acceleration"] < 0.2
    text = build(drive, "--out", tmp_path / "clips", "--seed", 1).stdout
    assert "Noise of the policy's labels" in text
    assert "acceleration (m/s2)" in text


def test_measured_motion_is_smoothed_where_that_is_asked_for(tmp_path, drive):
    smoothed = build(drive, "--out", tmp_path / "clips", "--poses", "reference", "--labels", "smoothed", "--json")
    assert json.loads(smoothed.stdout)["given_motion"]["labels"] == "smoothed"
    refused = build(drive, "--out", tmp_path / "clips", "--labels", "smoothed")
    assert "--poses reference" in str(refused.exception)


def test_the_motion_comes_from_where_it_is_said_to(tmp_path, drive):
    reference = build(drive, "--out", tmp_path / "clips", "--poses", "reference", "--json")
    summary = json.loads(reference.stdout)
    assert summary["trajectory"]["length"] == 0.0
    assert summary["scale_sigma"] is None
    assert "odometry" not in summary["seconds"]
    assert summary["sources"] == {"poses": "reference", "depth": "geometric", "views": "geometric"}
    for arguments in (("--poses", "mapanything"), ("--mapanything-weights", tmp_path)):
        result = build(drive, "--out", tmp_path / "clips", *arguments)
        assert "belong together" in str(result.exception)
    for arguments in (("--depth", "depthanything"), ("--depth-weights", tmp_path)):
        result = build(drive, "--out", tmp_path / "clips", *arguments)
        assert "--depth-weights belongs to" in str(result.exception)


@pytest.mark.slow
def test_missing_weights_are_named(tmp_path, drive):
    missing = build(drive, "--out", tmp_path / "c", "--poses", "mapanything", "--mapanything-weights", tmp_path)
    assert "facebook/map-anything" in str(missing.exception)
    for depth in ("depthanything", "depthcrafter"):
        missing = build(drive, "--out", tmp_path / "c", "--depth", depth, "--depth-weights", tmp_path)
        assert isinstance(missing.exception, InputError)
        assert str(tmp_path) in str(missing.exception)


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
        patch.setattr("olt_toolkit.clips.files.write_video", interrupt)
        assert build(drive, "--out", store).exit_code != 0
    assert [path for path in store.rglob("*") if path.is_file()] == []
    assert build(drive, "--out", store).exit_code == 0


@pytest.fixture
def drives(tmp_path, drive):
    """A folder of three recordings and a file that is none."""
    for name in ("bridge", "alley"):
        (tmp_path / f"{name}.drive").write_text("")
    (tmp_path / "notes.txt").write_text("")
    return tmp_path


def files_of(store: Path) -> dict[str, bytes]:
    return {str(path.relative_to(store)): path.read_bytes() for path in sorted(store.rglob("*")) if path.is_file()}


def test_a_folder_gives_one_clip_for_each_recording(drives):
    result = build(drives, "--out", drives / "clips", "--workers", 1, "--json")
    assert result.exit_code == 0, result.output
    outcomes = json.loads(result.stdout)["recordings"]
    assert [Path(outcome["path"]).stem for outcome in outcomes] == ["alley", "bridge", "town"]
    assert {outcome["state"] for outcome in outcomes} == {"built"}
    assert outcomes[0]["summary"]["clip"]["name"] == "alley"
    store = ClipStore(drives / "clips")
    assert [info.clip_id for info in store.clips()] == [outcome["clip_id"] for outcome in outcomes]
    assert (drives / "clips" / "previews" / f"bridge-{outcomes[1]['clip_id'][:8]}.webp").is_file()

    again = build(drives, "--out", drives / "clips", "--workers", 1, "--json")
    assert {outcome["state"] for outcome in json.loads(again.stdout)["recordings"]} == {"found"}
    assert "town.drive" in build(drives, "--out", drives / "clips", "--workers", 1).stdout


def test_another_front_view_is_another_clip_of_the_same_store(drives):
    store = drives / "clips"
    assert build(drives, "--out", store, "--workers", 1).exit_code == 0
    again = build(drives, "--out", store, "--workers", 1, "--front", "as-is", "--json")
    assert {outcome["state"] for outcome in json.loads(again.stdout)["recordings"]} == {"built"}
    assert len(ClipStore(store).clips()) == 6


def test_an_interrupted_folder_run_goes_on_and_ends_the_same(drives, source, monkeypatch):
    whole, resumed = drives / "whole", drives / "resumed"
    assert build(drives, "--out", whole, "--workers", 1).exit_code == 0
    opened = []

    def open_until_interrupted(path, options):
        opened.append(path.stem)
        if path.stem == "town":
            raise KeyboardInterrupt
        return type(source).record(source, path, options)

    with monkeypatch.context() as patch:
        patch.setattr(source, "record", open_until_interrupted)
        assert build(drives, "--out", resumed, "--workers", 1).exit_code != 0
    assert not (resumed / "clips.parquet").exists()
    assert "town" in opened
    result = build(drives, "--out", resumed, "--workers", 1, "--json")
    states = [outcome["state"] for outcome in json.loads(result.stdout)["recordings"]]
    assert states == ["found", "found", "built"]
    assert files_of(resumed) == files_of(whole)


def test_a_recording_that_fails_stops_the_run_or_is_listed_at_its_end(drives, source, monkeypatch):
    def open_or_fail(path, options):
        if path.stem == "bridge":
            raise InputError("bridge: too dark; give another video")
        return type(source).record(source, path, options)

    monkeypatch.setattr(source, "record", open_or_fail)
    stopped = build(drives, "--out", drives / "clips", "--workers", 1)
    assert "too dark" in str(stopped.exception)
    assert not (drives / "clips" / "clips.parquet").exists()
    kept = build(drives, "--out", drives / "clips", "--workers", 1, "--keep-going")
    assert "1 of 3 recordings could not be used" in str(kept.exception)
    assert "failed: bridge.drive: bridge: too dark" in kept.stdout
    assert [info.name for info in ClipStore(drives / "clips").clips()] == ["alley", "town"]


def test_folders_that_cannot_be_built_are_refused(drives):
    assert "leave --name out" in str(build(drives, "--out", drives / "clips", "--name", "x").exception)
    (drives / "empty").mkdir()
    assert "no recording" in str(build(drives / "empty", "--out", drives / "clips").exception)


def test_only_the_wanted_views_are_written(tmp_path, drive):
    out = tmp_path / "views"
    result = run("views", drive, "--cameras", "cross_left, front_wide", "--out", out, "--width", 96, "--height", 54)
    assert result.exit_code == 0, result.output
    assert "left out: camera_cross_right_120fov" in result.stdout
    plan = json.loads((out / "plan.json").read_text())
    assert list(plan["views"]) == [CROSS_LEFT, FRONT_WIDE]
    assert plan["order"] == [FRONT_WIDE, CROSS_LEFT]
    assert plan["views"][CROSS_LEFT]["method"] == "synthesized"
    assert {omission["what"] for omission in plan["left_out"]} > {CROSS_RIGHT, "camera_rear_tele_30fov"}
    videos = sorted(path.name for path in out.glob("*.mp4"))
    assert videos == [f"{CROSS_LEFT}.mp4", f"{FRONT_WIDE}.mp4"]
    assert read_video(out / videos[0]).frames.shape == (FRAMES, 54, 96, 3)
    assert (out / "views.png").is_file()
    assert (out / "views.webp").is_file()


def test_views_cut_out_of_the_front_view_need_no_motion(tmp_path, drive, monkeypatch):
    def measure(*_arguments):
        raise AssertionError("measured although no view needs it")

    monkeypatch.setattr("olt_generator.motion.odometry.estimate_odometry", measure)
    arguments = ("--cameras", "front_tele", "--width", 96, "--height", 54, "--json")
    result = run("views", drive, "--out", tmp_path / "views", *arguments)
    assert result.exit_code == 0, result.output
    plan = json.loads(result.stdout)
    assert list(plan["views"]) == ["camera_front_tele_30fov"]
    assert "motion of the vehicle" in [omission["what"] for omission in plan["left_out"]]


def test_further_views_are_made_of_a_stored_clip(tmp_path, drive):
    assert build(drive, "--out", tmp_path / "clips").exit_code == 0
    arguments = ("--cameras", "front_wide", "--width", 96, "--height", 54, "--json")
    result = run("views", tmp_path / "clips", "town", "--out", tmp_path / "views", *arguments)
    assert result.exit_code == 0, result.output
    plan = json.loads(result.stdout)
    assert plan["recording"] == "town"
    assert "stored" in plan["assumptions"][0]
    store = ClipStore(tmp_path / "clips")
    clip_id = store.clips()[0].clip_id
    stored, _ = store.read_frames(clip_id, FRONT_WIDE, store.read_timestamps(clip_id, FRONT_WIDE))
    written = read_video(tmp_path / "views" / f"{FRONT_WIDE}.mp4").frames
    assert np.abs(stored.astype(int) - written).mean() < 6.0


def test_the_rig_and_the_front_lens_are_chosen_by_name(tmp_path, drive):
    store = tmp_path / "clips"
    result = build(drive, "--out", store, "--rig", "alpamayo-2", "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert list(summary["clip"]["views"]) == list(find_contract("alpamayo-2").cameras)
    assert summary["clip"]["contracts"] == ["alpamayo-r1", "alpamayo-1.5", "alpamayo-2"]
    named = summary["clip"]["views"][FRONT_WIDE]
    assert 0.1 < named["unseen_share"] < 0.9
    assert any("driven past" in note for note in summary["assumptions"])

    result = build(drive, "--out", store, "--front", "as-is", "--name", "own", "--json")
    summary = json.loads(result.stdout)
    assert summary["clip"]["views"][FRONT_WIDE]["unseen_share"] == 0.0
    assert any("keeps the recording's lens, 60 degrees" in note for note in summary["assumptions"])
    result = build(drive, "--out", store, "--rig", "alpamayo-3")
    assert result.exit_code == 2

    shown = run("inspect", store, "town")
    assert "cameras of: alpamayo-r1, alpamayo-1.5, alpamayo-2" in shown.stdout
    assert "not seen" in shown.stdout
    result = run(
        "views", drive, "--rig", "alpamayo-2", "--out", tmp_path / "v", "--width", 96, "--height", 54, "--json"
    )
    plan = json.loads(result.stdout)
    assert set(plan["views"]) == set(find_contract("alpamayo-2").cameras)
    runs = decode_origin((tmp_path / "v" / f"{CROSS_LEFT}.pixel_origin.parquet").read_bytes(), "here")
    assert runs.shares["invented_share"] == plan["views"][CROSS_LEFT]["invented_share"]


def test_a_folder_is_not_built_for_another_rig_into_the_same_store(drives):
    assert build(drives, "--out", drives / "clips", "--workers", 1).exit_code == 0
    result = build(drives, "--out", drives / "clips", "--workers", 1, "--rig", "alpamayo-2")
    assert isinstance(result.exception, InputError)
    assert "already holds the clip" in str(result.exception)
    assert "rear_left" in str(result.exception)


def test_unknown_cameras_are_refused(tmp_path, drive):
    for text in ("roof", "", "cross_left,roof"):
        result = run("views", drive, "--cameras", text, "--out", tmp_path / "views")
        assert isinstance(result.exception, InputError)
        assert "cross_right" in str(result.exception)
    assert not (tmp_path / "views").exists()


@pytest.fixture
def store(tmp_path, make_clip):
    store = ClipStore(tmp_path / "clips")
    store.prepare(make_clip("bend"))
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
        "first_us": 81_000,
        "last_us": 8_981_000,
        "frames_not_seen": 0,
    }
    text = run("inspect", store.root, clip_id).stdout
    assert "clip bend (GT, nominal, train)" in text
    assert "0.00 to 8.90 s" in text


def test_inspect_tells_doubts_and_uncertainty(tmp_path, make_clip):
    store = ClipStore(tmp_path / "clips")
    known = replace(
        make_clip("bend"),
        doubts=("direction",),
        scale_sigma=0.051,
        acceleration_noise=0.31,
        acceleration_noise_basis="estimated",
    )
    store.prepare(known)
    store.commit([known.clip_id])
    text = run("inspect", store.root, "bend").stdout
    assert "in doubt: direction" in text
    assert "scale, 1 sigma: 5.1 %" in text
    assert "noise of acceleration labels: 0.31 m/s2, estimated" in text
    assert "action errors: median 0.034 m, worst 0.052 m; 0 of 9 samples beyond 0.3 m" in text
    assert "direction" in run("inspect", store.root).stdout
    assert json.loads(run("inspect", store.root, "--json").stdout)["clips"][0]["doubts"] == ["direction"]


def test_inspect_draws_a_clip(store, tmp_path):
    result = run("inspect", store.root, "bend", "--pictures", tmp_path / "pictures")
    assert result.exit_code == 0, result.output
    called = f"bend-{make_clip_id('bend')[:8]}"
    assert sorted(path.name for path in (tmp_path / "pictures").iterdir()) == [f"{called}.png", f"{called}.webp"]
    assert f"{called}.webp" in result.stdout
    assert "name the clip" in str(run("inspect", store.root, "--pictures", tmp_path / "pictures").exception)


def test_inspect_names_what_is_missing(store, tmp_path):
    assert "not a clip store" in str(run("inspect", tmp_path).exception)
    assert "no clip" in str(run("inspect", store.root, make_clip_id("other")).exception)


def test_a_stored_clip_takes_nothing_that_is_said_of_recordings(tmp_path, drive):
    assert build(drive, "--out", tmp_path / "clips").exit_code == 0
    for option in (["--fov", 50], ["--mirror"], ["--duration", 3], ["--cache", tmp_path], ["--poses", "reference"]):
        views = "views", tmp_path / "clips", "town", "--cameras", "rear_tele", "--out", tmp_path / "views"
        result = run(*views, *option)
        assert f"{option[0]}: a stored clip has its lens, motion and duration" in str(result.exception)
