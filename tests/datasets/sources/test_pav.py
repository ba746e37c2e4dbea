"""PhysicalAI-AV trees: what the clip store writes is read back, and what the real data set has beside it."""

import json
import shutil
import struct
import zipfile

import numpy as np
import pandas as pd
import pytest

from olt_datasets.sources.pav import DATASET
from olt_generator.errors import InputError
from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.builder import BuildOptions, build_clip
from olt_toolkit.clips.clip import CameraStream, Clip, ClipOrigin, EgoMotion, ViewProvenance, make_clip_id
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.recordings.drives import open_dataset
from olt_toolkit.recordings.recording import OpenOptions
from olt_toolkit.rigs.rig import CROSS_LEFT, DEFAULT_VEHICLE, FRONT_TELE, FRONT_WIDE, POLICY_CAMERAS
from olt_toolkit.rigs.rig_files import load_rig, pav_rig

from ...fuzzing import SECONDS

SIZE = (64, 36)
FRAMES = 240
START_US = 12_000
KEY, OTHER = make_clip_id("pav"), make_clip_id("other")
FRONT_ZIP = "camera/camera_front_wide_120fov/camera_front_wide_120fov.chunk_0000.zip"


def frames_of(camera):
    """Frames of one grey level each, which tells their number."""
    levels = 10 + (3 * np.arange(FRAMES) + 7 * camera) % 230
    return np.repeat(levels.astype(np.uint8), SIZE[0] * SIZE[1] * 3).reshape(FRAMES, SIZE[1], SIZE[0], 3)


def make_clip(clip_id):
    """A bend at 8 m/s at 30 Hz; cross-left films 10 ms later, and its lens is shifted from the nominal one."""
    times = START_US + np.rint(np.arange(FRAMES) * 1e6 / 30).astype(np.int64)
    ego_us = np.arange(-100_000, 8_200_000, 10_000, dtype=np.int64)
    yaw = 0.16 * ego_us * 1e-6
    motion = Trajectory(ego_us, planar_pose(50 * np.sin(yaw), 50 * (1 - np.cos(yaw)), yaw))
    rig = pav_rig().fitted(*SIZE)
    streams = {}
    for index, name in enumerate(POLICY_CAMERAS):
        lens = rig[name].camera
        own = lens.redrawn(*SIZE, (1.0, 1.0), (lens.cx + 1.5, lens.cy))
        later = 10_000 if name == CROSS_LEFT else 0
        streams[name] = CameraStream(frames_of(index), times + later, 30.0, own, rig[name].T_rig_camera)
    return Clip(
        clip_id=clip_id,
        name=clip_id,
        scene_id=clip_id,
        source="test",
        origin=ClipOrigin(clip_id, 0, int(times[-1])),
        kind="GT",
        category="nominal",
        factors=(),
        split="val",
        streams=streams,
        ego_motion=EgoMotion.from_trajectory(motion),
        vehicle=DEFAULT_VEHICLE,
        provenance={name: ViewProvenance("observed", "test", "1", None, 1.0, 0.0) for name in streams},
    )


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    store = ClipStore(tmp_path_factory.mktemp("store"))
    for key in (KEY, OTHER):
        store.prepare(make_clip(key))
    store.commit([KEY, OTHER])
    return store


@pytest.fixture
def tree(store, tmp_path):
    """The store's tree without what makes it a store: a PhysicalAI-AV tree."""
    root = tmp_path / "pav"
    shutil.copytree(store.root, root)
    (root / "clips.parquet").unlink()
    return root


def change_table(path, change):
    frame = pd.read_parquet(path)
    changed = change(frame)
    (frame if changed is None else changed).to_parquet(path)


def write_reasoning(root, **columns):
    path = root / "reasoning" / "ood_reasoning.parquet"
    path.parent.mkdir(exist_ok=True)
    pd.DataFrame(columns, index=pd.Index([KEY], name="clip_id")).to_parquet(path)


def test_drives_are_told_without_images(tree, tmp_path):
    dataset = open_dataset(tree, tmp_path)
    assert (dataset.source, dataset.keys()) == ("pav", sorted([KEY, OTHER]))
    drive = dataset.drive(KEY)
    assert drive.scene_id == f"pav/{KEY}"
    assert drive.front_us.tolist() == np.rint(np.arange(FRAMES) * 1e6 / 30).astype(int).tolist()
    assert drive.ego_span_us == (-112_000, 8_190_000 - START_US)
    assert set(drive.cameras) == set(drive.true_views) == set(POLICY_CAMERAS)
    assert (drive.split, drive.country, drive.category, drive.event_t0s_us) == ("val", None, "unlabelled", ())


def test_what_the_store_holds_is_what_is_read(store, tree, tmp_path):
    """Images, lens, mounting and poses are equal; cross-left images are those nearest in time."""
    window = (1_000_000, 1_400_000)
    recording = DATASET.open(tree, tmp_path).open(KEY, window, OpenOptions())
    front_us = store.read_timestamps(KEY, FRONT_WIDE)
    inside = (front_us - START_US >= window[0]) & (front_us - START_US <= window[1])
    times_us = front_us[inside]
    np.testing.assert_array_equal(recording.timestamps_us, times_us - times_us[0])
    np.testing.assert_array_equal(recording.frames, store.read_frames(KEY, FRONT_WIDE, times_us)[0])
    assert recording.views.keys() == set(POLICY_CAMERAS) - {FRONT_WIDE}
    for name, images in recording.views.items():
        later = 10_000 if name == CROSS_LEFT else 0
        np.testing.assert_array_equal(images, store.read_frames(KEY, name, times_us + later)[0])
        stored = store.read_camera(KEY, name)
        assert recording.mounted[name].camera == stored.camera
        np.testing.assert_array_equal(recording.mounted[name].T_rig_camera, stored.T_rig_camera)
    assert recording.camera == store.read_camera(KEY, FRONT_WIDE).camera
    assert recording.vehicle == DEFAULT_VEHICLE
    motion = store.read_ego_motion(KEY)
    np.testing.assert_array_equal(recording.reference.T_world_rig, motion.trajectory.T_world_rig)
    np.testing.assert_array_equal(recording.reference.timestamps_us, motion.trajectory.timestamps_us - times_us[0])
    assert any("cross_left" in note and "10.0 ms" in note for note in recording.assumptions)
    assert recording.observed == {}


def test_a_long_window_is_decoded_in_parts(tree, tmp_path):
    recording = DATASET.open(tree, tmp_path).open(KEY, (0, 10_000_000), OpenOptions(width=32, views=()))
    assert recording.frames.shape == (FRAMES, 18, 32, 3)
    assert np.abs(recording.frames[:, 9, 16, 0].astype(int) - frames_of(1)[:, 0, 0, 0]).max() <= 2
    assert recording.views == {}


def test_the_clip_of_a_window_has_the_lenses_of_the_vehicle(tree, tmp_path):
    recording = DATASET.open(tree, tmp_path).open(KEY, (0, 400_000), OpenOptions())
    built = build_clip(recording, BuildOptions(width=64, height=36, use_reference_views=True, frames="all"))
    assert built.clip.kind == "GT"
    assert {view.kind for view in built.clip.provenance.values()} == {"observed"}
    for name in (CROSS_LEFT, FRONT_TELE):
        stream = built.clip.streams[name]
        assert stream.camera == recording.mounted[name].camera
        np.testing.assert_array_equal(stream.frames, recording.views[name])


def test_what_the_tables_tell_is_told(tree, tmp_path):
    index, collection = tree / "clip_index.parquet", tree / "metadata" / "data_collection.parquet"
    change_table(collection, lambda frame: frame.assign(country=["Germany" if k == KEY else None for k in frame.index]))
    change_table(index, lambda frame: frame.assign(event_t0s=[[5_100_000] if k == KEY else None for k in frame.index]))
    events = [{"event_start_timestamp": t, "cot": "yield"} for t in (6_012_000, 3_012_000, 19_000_000)]
    write_reasoning(tree, events=[json.dumps(events)], event_cluster=["Work Zone / cones"])
    drive = DATASET.open(tree, tmp_path).drive(KEY)
    assert drive.event_t0s_us == (3_000_000, 5_100_000 - START_US, 6_000_000)
    assert (drive.category, drive.country) == ("work_zone_cones", "DE")
    other = DATASET.open(tree, tmp_path).drive(OTHER)
    assert (other.event_t0s_us, other.category, other.country) == ((), "unlabelled", None)
    write_reasoning(tree, events=[events[:1]])
    drive = DATASET.open(tree, tmp_path).drive(KEY)
    assert (drive.event_t0s_us, drive.category) == ((5_100_000 - START_US, 6_000_000), "unlabelled")


def test_clips_that_are_not_valid_or_elsewhere_are_left_out(tree, tmp_path):
    index = tree / "clip_index.parquet"
    change_table(index, lambda frame: frame.assign(chunk=[0 if k == KEY else 7 for k in frame.index]))
    assert DATASET.open(tree, tmp_path).keys() == [KEY]
    change_table(index, lambda frame: frame.assign(clip_is_valid=[k != KEY for k in frame.index]))
    assert DATASET.open(tree, tmp_path).keys() == []
    with pytest.raises(InputError, match="no valid clip"):
        DATASET.open(tree, tmp_path).drive(KEY)


def test_a_tree_with_some_zips_missing_is_read(tree, tmp_path):
    """Cross-left is nowhere in the data set, cross-right and the ego motion not on disk."""
    presence = tree / "metadata" / "feature_presence.parquet"
    change_table(presence, lambda frame: frame.assign(**{CROSS_LEFT: False}))
    shutil.rmtree(tree / "camera" / "camera_cross_right_120fov")
    shutil.rmtree(tree / "labels")
    dataset = DATASET.open(tree, tmp_path)
    drive = dataset.drive(KEY)
    assert set(drive.true_views) == {FRONT_WIDE, FRONT_TELE}
    assert drive.ego_span_us is None
    assert "Images of cross_right are not in this folder." in drive.notes
    assert not any("cross_left" in note for note in drive.notes)
    recording = dataset.open(KEY, (0, 200_000), OpenOptions())
    assert set(recording.views) == {FRONT_TELE}
    assert recording.reference is None
    presence.rename(tree / "metadata" / "sensor_presence.parquet")
    assert set(DATASET.open(tree, tmp_path).drive(KEY).true_views) == {FRONT_WIDE, FRONT_TELE}
    shutil.rmtree(tree / "calibration" / "sensor_extrinsics")
    with pytest.raises(InputError, match=r"sensor_extrinsics\.chunk_0000\.parquet: no such file"):
        dataset.open(KEY, (0, 200_000), OpenOptions())


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("clip_index.parquet", lambda frame: frame.reset_index(), "index is missing|it must be clip_id"),
        ("clip_index.parquet", lambda frame: frame.astype({"chunk": float}), "column chunk is float64"),
        ("clip_index.parquet", lambda frame: frame.assign(clip_is_valid=1), "column clip_is_valid is int64"),
        ("clip_index.parquet", lambda frame: frame.assign(split="holdout"), "column split holds 'holdout'"),
        ("clip_index.parquet", lambda frame: frame.drop(columns="split"), "column split is missing"),
        ("clip_index.parquet", lambda frame: pd.concat([frame, frame]), "more than once"),
        ("clip_index.parquet", lambda frame: frame.rename(index={OTHER: "../x"}), "not a UUID"),
        ("clip_index.parquet", lambda frame: frame.assign(event_t0s=[[0.5]] * 2), r"event_t0s holds 0\.5"),
        ("metadata/data_collection.parquet", lambda frame: frame.assign(country="Atlantis"), "'Atlantis'"),
    ],
)
def test_damaged_tables_are_named(tree, tmp_path, file, change, message):
    change_table(tree / file, change)
    with pytest.raises(InputError, match=message):
        DATASET.open(tree, tmp_path).drive(KEY)


@pytest.mark.parametrize("events", ["no json", json.dumps([{"cot": "yield"}]), json.dumps([3]), "7"])
def test_damaged_events_are_named(tree, tmp_path, events):
    write_reasoning(tree, events=[events])
    with pytest.raises(InputError, match=r"ood_reasoning\.parquet: clip .* event_start_timestamp"):
        DATASET.open(tree, tmp_path).drive(KEY)


def test_members_that_lead_elsewhere_are_never_looked_at(tree, tmp_path):
    with zipfile.ZipFile(tree / FRONT_ZIP, "a") as archive:
        archive.writestr("../../stray.txt", b"stray")
    recording = DATASET.open(tree, tmp_path).open(KEY, (0, 200_000), OpenOptions(views=()))
    assert len(recording.frames) == 7
    assert not list(tmp_path.rglob("stray.txt"))


def test_a_member_that_claims_to_be_huge_is_refused(tree, tmp_path):
    path = tree / FRONT_ZIP
    data = bytearray(path.read_bytes())
    name = f"{KEY}.{FRONT_WIDE}.timestamps.parquet".encode()
    entry = data.rfind(name) - 46  # the member's record in the directory at the end, whose size stands 24 bytes in
    data[entry + 24 : entry + 28] = struct.pack("<I", 0xF000_0000)
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"member .*timestamps\.parquet claims \d+ bytes"):
        DATASET.open(tree, tmp_path).drive(KEY)


def test_damaged_zips_and_videos_are_named(tree, tmp_path):
    path = tree / FRONT_ZIP
    members = {}
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    video = f"{KEY}.{FRONT_WIDE}.mp4"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data[: len(data) // 2] if name == video else data)
    with pytest.raises(InputError, match=r"chunk_0000\.zip: .*mp4"):
        DATASET.open(tree, tmp_path).open(KEY, (0, 7_000_000), OpenOptions(views=()))
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match=r"chunk_0000\.zip"):
        DATASET.open(tree, tmp_path).drive(KEY)


def test_a_lens_of_another_size_is_refused(tree, tmp_path):
    path = tree / "calibration" / "camera_intrinsics" / "camera_intrinsics.chunk_0000.parquet"
    change_table(path, lambda frame: frame.assign(width=62, height=34))
    with pytest.raises(InputError, match=r"frames of 64 x 36 pixels; .* gives the camera 62 x 34"):
        DATASET.open(tree, tmp_path).open(KEY, (0, 200_000), OpenOptions(views=()))
    change_table(path, lambda frame: frame.assign(fw_poly_1=-1.0))
    with pytest.raises(InputError, match=rf"clip {KEY}: camera_front_wide_120fov: f-theta lens"):
        DATASET.open(tree, tmp_path).open(KEY, (0, 200_000), OpenOptions(views=()))


def test_a_clip_store_is_no_data_set(store, tmp_path):
    assert not DATASET.recognises(store.root)
    with pytest.raises(InputError, match="whose images need not be true"):
        DATASET.open(store.root, tmp_path)
    with pytest.raises(InputError, match=r"clip_index\.parquet: no such file"):
        DATASET.open(tmp_path, tmp_path)
    assert set(POLICY_CAMERAS) < set(load_rig("pav").cameras)


def test_a_look_at_a_clip(tree, tmp_path, check_peek):
    check_peek(DATASET.open(tree, tmp_path), KEY)
    dataset = DATASET.open(tree, tmp_path)
    wanted = dataset.drive(KEY).front_us[[20, 29, 44]]
    images, times_us = dataset.peek(KEY, wanted, 32, np.full(3, 400_000))
    # Every 30th frame is a key frame; that one is 10 frames away, 1 frame, and 14 frames, which is too far.
    assert times_us.tolist() == dataset.drive(KEY).front_us[[30, 30, 44]].tolist()
    assert np.abs(images[:, 9, 16, 0].astype(int) - frames_of(1)[[30, 30, 44], 0, 0, 0]).max() <= 2


PAV_FILES = [
    "clip_index.parquet",
    "labels/egomotion/egomotion.chunk_0000.zip",
    f"camera/{FRONT_WIDE}/{FRONT_WIDE}.chunk_0000.zip",
]


@pytest.mark.parametrize("name", PAV_FILES)
def test_damaged_files_are_read_or_refused_in_words(fuzzer, tree, name):
    fuzzer.run("dataset", tree / name, tree, examples=8)


@pytest.mark.slow
@pytest.mark.parametrize("name", PAV_FILES)
def test_damaged_files_for_long(fuzzer, tree, name):
    fuzzer.run("dataset", tree / name, tree, seconds=SECONDS)
