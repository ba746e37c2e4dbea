"""PandaSet trees: frames, distortion, and the only moment that gives a sample."""

import json
import shutil

import numpy as np
import pytest

from olt_datasets.sources.pandaset import DATASET
from olt_generator.cameras import PinholeCamera
from olt_generator.errors import InputError
from olt_generator.poses import invert, yaw_of
from olt_toolkit.clips.builder import BuildOptions, build_clip
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.policy.window import Coverage, sample_times
from olt_toolkit.recordings.drives import open_dataset
from olt_toolkit.recordings.recording import OpenOptions
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, FRONT_TELE, FRONT_WIDE, POLICY_CAMERAS, MountedCamera
from olt_toolkit.rigs.rig_files import load_rig

CAMERA = "001/camera/front_camera"
OPTIONS = OpenOptions(width=96)


@pytest.fixture
def own_tree(pandaset_tree, tmp_path):
    """A copy of the tree whose tables may be changed."""
    for path in pandaset_tree.rglob("*"):
        copy = tmp_path / "tree" / path.relative_to(pandaset_tree)
        if path.is_file():
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.hardlink_to(path) if path.suffix == ".jpg" else shutil.copy(path, copy)
    return tmp_path / "tree"


def change(path, edit):
    content = json.loads(path.read_text())
    path.write_text(json.dumps(edit(content)))


def test_drives_are_told_without_images(pandaset_tree, tmp_path):
    dataset = open_dataset(pandaset_tree, tmp_path)
    assert (dataset.source, dataset.keys()) == ("pandaset", ["001"])
    drive = dataset.drive("001")
    assert drive.scene_id.startswith("pandaset/")
    assert drive.front_us.tolist() == [100_000 * k for k in range(80)]
    assert drive.ego_span_us == (0, 7_900_000)
    assert set(drive.cameras) == {"front_camera", "front_left_camera", "left_camera", "front_right_camera"}
    assert set(drive.true_views) == {FRONT_WIDE, FRONT_TELE, CROSS_LEFT, CROSS_RIGHT}
    assert drive.category == "unlabelled"
    assert any("t0 can only lie between 1.500 and 1.500 s" in note for note in drive.notes)
    assert any("cross_left view is a mosaic of several cameras, which shows 80% of it" in note for note in drive.notes)


def test_sequences_are_told_by_their_times_and_first_image(pandaset_tree, own_tree, tmp_path):
    scene_id = DATASET.open(pandaset_tree, tmp_path).drive("001").scene_id
    (own_tree / "001").rename(own_tree / "042")
    assert DATASET.open(own_tree, tmp_path).drive("042").scene_id == scene_id
    change(own_tree / "042" / "camera" / "front_camera" / "timestamps.json", lambda times: [t + 1000 for t in times])
    assert DATASET.open(own_tree, tmp_path).drive("042").scene_id != scene_id


def test_there_is_exactly_one_sample_once_clip_time_begins_earlier(pandaset_tree, tmp_path):
    """As the note says: none as it is, because loaders refuse t0 up to 1.6 s; one where time is shifted by 0.2 s."""
    first, last = DATASET.open(pandaset_tree, tmp_path).drive("001").ego_span_us
    counts = []
    for shift in (0, 200_000):
        span = (first + shift, last + shift)
        counts.append(len(sample_times(Coverage(span, dict.fromkeys(POLICY_CAMERAS, span)))[0]))
    assert counts == [0, 1]


def test_a_window_gives_motion_and_images_of_its_time(pandaset_tree, tmp_path, true_motion, world):
    recording = DATASET.open(pandaset_tree, tmp_path).open("001", (1_000_000, 1_250_000), OPTIONS)
    assert recording.timestamps_us.tolist() == [0, 100_000, 200_000]
    assert (int(recording.reference.timestamps_us[0]), int(recording.reference.timestamps_us[-1])) == (
        -1_000_000,
        6_900_000,
    )
    np.testing.assert_allclose(recording.reference.T_world_rig, true_motion(0.1 * np.arange(80)), atol=1e-6)
    velocity = EgoMotion.from_trajectory(recording.reference).velocity
    np.testing.assert_allclose(velocity[10], [8.0, 0.0, 0.0], atol=0.02)
    assert np.all(np.diff(yaw_of(recording.reference.T_world_rig)) > 0)
    assert isinstance(recording.camera, PinholeCamera)
    assert recording.frames.shape == (3, 54, 96, 3)


def test_distortion_is_taken_out_of_the_front_and_mosaics_are_marked(pandaset_tree, tmp_path, world):
    recording = DATASET.open(pandaset_tree, tmp_path).open("001", (0, 100_000), OPTIONS)
    front = MountedCamera(recording.camera, recording.T_rig_camera)
    assert world.mistakes(recording.frames[1], front).max() <= 4
    assert recording.views.keys() == set(POLICY_CAMERAS)
    for name, images in recording.views.items():
        seen = recording.observed[name]
        mistakes = world.mistakes(images[1], recording.mounted[name])
        assert np.percentile(mistakes[seen], 99) <= 5
        assert images[:, ~seen].max(initial=0) == 0
    assert any("front_left_camera, left_camera" in note and "20 ms" in note for note in recording.assumptions)


def test_only_wanted_views_are_made(pandaset_tree, tmp_path):
    dataset = DATASET.open(pandaset_tree, tmp_path)
    assert dataset.open("001", (0, 100_000), OpenOptions(width=96, views=())).views == {}
    assert set(dataset.open("001", (0, 100_000), OpenOptions(width=96, views=(CROSS_LEFT,))).views) == {CROSS_LEFT}


def test_the_clip_of_a_window_tells_what_was_seen(pandaset_tree, tmp_path):
    recording = DATASET.open(pandaset_tree, tmp_path).open("001", (0, 100_000), OPTIONS)
    built = build_clip(recording, BuildOptions(width=96, height=54, use_reference_views=True))
    provenance = built.clip.provenance
    assert built.clip.kind == "GT"
    assert {view.kind for view in provenance.values()} == {"mosaic"}
    assert provenance[CROSS_LEFT].observed_share == pytest.approx(0.80, abs=0.01)
    assert provenance[CROSS_LEFT].unseen_share == pytest.approx(0.20, abs=0.01)
    assert provenance[CROSS_LEFT].invented_share == 0.0
    assert provenance[FRONT_TELE].observed_share == 1.0
    stream = built.clip.streams[FRONT_WIDE]
    np.testing.assert_array_equal(stream.T_rig_camera, recording.mounted[FRONT_WIDE].T_rig_camera)
    assert built.clip.ego_motion.span_us == (0, 7_900_000)


def test_missing_cameras_show_less_and_are_no_views(own_tree, tmp_path):
    """Without the left camera less is seen; one that lacks its last images is left out of mosaics."""
    shutil.rmtree(own_tree / "001/camera/left_camera")
    for index in (78, 79):
        (own_tree / f"001/camera/front_right_camera/{index}.jpg").unlink()
    for name in ("timestamps", "poses"):
        change(own_tree / f"001/camera/front_right_camera/{name}.json", lambda rows: rows[:78])
    drive = DATASET.open(own_tree, tmp_path).drive("001")
    assert drive.true_views == (CROSS_LEFT, FRONT_WIDE, FRONT_TELE)
    assert set(drive.cameras) == {"front_camera", "front_left_camera", "front_right_camera"}
    assert any("cross_left view is a mosaic of several cameras, which shows 6" in note for note in drive.notes)
    assert any("front_right_camera lacks images" in note for note in drive.notes)


@pytest.mark.parametrize(
    ("file", "edit", "message"),
    [
        ("intrinsics.json", lambda _: {"fx": 1.0, "fy": 1.0, "cx": 2.0}, r"intrinsics\.json: cy"),
        ("intrinsics.json", lambda old: old | {"fx": -1.0}, r"intrinsics\.json: fx"),
        ("timestamps.json", lambda times: times[:60], "60 times for 80 images"),
        ("timestamps.json", lambda times: [*times[:5], times[4], *times[6:]], "time 5 is not after"),
        ("timestamps.json", lambda _: ["soon"] * 80, r"timestamps\.json: 0"),
        ("poses.json", lambda poses: poses[:79], "79 poses for 80 images"),
        ("poses.json", lambda poses: [poses[0] | {"heading": {"w": 0, "x": 0, "y": 0, "z": 0}}, *poses[1:]], "length"),
        ("poses.json", lambda poses: [{"position": poses[0]["position"]}, *poses[1:]], r"poses\.json: 0\.heading"),
        ("poses.json", lambda poses: poses[0], r"poses\.json"),
    ],
)
def test_damaged_tables_are_named(own_tree, tmp_path, file, edit, message):
    change(own_tree / CAMERA / file, edit)
    with pytest.raises(InputError, match=message):
        DATASET.open(own_tree, tmp_path).drive("001")


def test_damaged_images_and_unknown_keys_are_named(own_tree, tmp_path):
    dataset = DATASET.open(own_tree, tmp_path)
    image = own_tree / CAMERA / "00.jpg"
    image.unlink()
    image.write_bytes(b"no image")
    with pytest.raises(InputError, match=r"00\.jpg: cannot be decoded"):
        dataset.open("001", (0, 100_000), OPTIONS)
    for key in ("002", "../001"):
        with pytest.raises(InputError, match="no sequence"):
            dataset.drive(key)
    with pytest.raises(InputError, match="no front image"):
        dataset.open("001", (9_000_000, 9_500_000), OPTIONS)
    (own_tree / CAMERA / "poses.json").write_text("[{")
    with pytest.raises(InputError, match=r"poses\.json: not readable as JSON"):
        dataset.drive("001")


def test_other_folders_are_not_taken(tmp_path):
    assert not DATASET.recognises(tmp_path)
    with pytest.raises(InputError, match="holds no PandaSet sequence"):
        DATASET.open(tmp_path, tmp_path)


def test_the_body_turned_over_by_hand():
    """From the static calibration: the front camera looks along -y of the LiDAR, the left one along its x."""
    rig = load_rig("pandaset")
    R_lidar_rig = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for name, axis in {"front_camera": [0, -1, 0], "left_camera": [1, 0, 0]}.items():
        assert (R_lidar_rig @ rig[name].T_rig_camera[:3, 2]) @ axis > 0.99
    assert np.linalg.det(invert(rig["back_camera"].T_rig_camera)[:3, :3]) == pytest.approx(1.0)


def test_a_look_at_a_drive(pandaset_tree, tmp_path, check_peek):
    """At an eighth of the size, and as large as the images are."""
    check_peek(DATASET.open(pandaset_tree, tmp_path), "001", 160)
    check_peek(DATASET.open(pandaset_tree, tmp_path), "001", 1920)
