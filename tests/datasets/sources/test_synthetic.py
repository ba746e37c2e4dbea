"""The synthetic world as a data set."""

from dataclasses import replace

import numpy as np
import pytest

from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.sensors.recorder import record_drive
from olt_generator.errors import InputError
from olt_generator.poses import planar_pose, transform, yaw_of
from olt_toolkit.clips.builder import BuildOptions, build_clip
from olt_toolkit.recordings.drives import open_dataset
from olt_toolkit.recordings.recording import OpenOptions
from olt_toolkit.rigs.contracts import find_contract
from olt_toolkit.rigs.rig import CAMERA_INDEX, CROSS_LEFT, FRONT_WIDE, REAR_LEFT, REAR_RIGHT

SPECIFICATION = """
categories: [work_zone, nominal]
seed: 7
count: 2
"""
SMALL = OpenOptions(width=64, views=(CROSS_LEFT,))


@pytest.fixture
def open_world(tmp_path):
    def write_and_open(text=SPECIFICATION):
        (tmp_path / "synthetic.yaml").write_text(text)
        return open_dataset(tmp_path, tmp_path / "cache")

    return write_and_open


def test_drives_are_those_asked_for(open_world):
    dataset = open_world(SPECIFICATION + "duration: 9.0\nframe_rate: 5.0\nsplit: val\n")
    assert dataset.source == "synthetic"
    assert dataset.keys() == ["nominal_000007", "nominal_000008", "work_zone_000007", "work_zone_000008"]
    drive = dataset.drive("work_zone_000008")
    assert drive.front_us.tolist() == [200_000 * k for k in range(46)]
    assert drive.ego_span_us == (0, 9_000_000)
    assert drive.scene_id == "synthetic/work_zone_000008"
    assert drive.category == "work_zone"
    assert drive.factors == generate_scene("work_zone", 8).factors != ()
    assert drive.split == "val"
    assert set(drive.true_views) == set(drive.cameras) == set(CAMERA_INDEX)


def test_the_scene_is_the_world_and_the_take_how_it_is_filmed(open_world):
    key = "nominal_000007"
    usual, night, fast = (
        open_world(SPECIFICATION + more).drive(key)
        for more in ("", "conditions: {light: night}\n", "frame_rate: 20.0\n")
    )
    assert usual.scene_id == night.scene_id == fast.scene_id
    assert usual.take == open_world(SPECIFICATION + "conditions: {light: day}\nduration: 9.0\n").drive(key).take == ""
    assert len({usual.take, night.take, fast.take}) == 3


def test_a_window_is_that_part_of_the_whole_drive(open_world):
    dataset = open_world()
    window = dataset.open("nominal_000007", (1_050_000, 1_300_000), SMALL)
    whole = record_drive(generate_scene("nominal", 7), 64, 36, 10.0, (CROSS_LEFT,), window_us=(0, 1_300_000))
    assert window.timestamps_us.tolist() == [0, 100_000, 200_000]
    assert np.array_equal(window.frames, whole.frames[11:14])
    assert list(window.views) == [CROSS_LEFT]
    assert np.array_equal(window.views[CROSS_LEFT], whole.views[CROSS_LEFT][11:14])
    assert np.array_equal(window.reference.T_world_rig, whole.reference.T_world_rig)
    assert (window.reference.timestamps_us + 1_100_000).tolist() == whole.reference.timestamps_us.tolist()
    assert len(window.reference) == 141


def test_the_same_file_gives_the_same_images(open_world):
    first, second = (open_world().open("work_zone_000007", (0, 100_000), SMALL) for _ in range(2))
    assert np.array_equal(first.frames, second.frames)
    other = open_world().open("work_zone_000008", (0, 100_000), SMALL)
    assert not np.array_equal(first.frames, other.frames)


def test_light_weather_and_cameras_are_those_asked_for(open_world):
    plain = open_world().open("nominal_000007", (0, 100_000), SMALL)
    text = SPECIFICATION + "conditions: {light: night, rain: 0.4}\ncamera: {noise: 5.0, drops: 0.5}\n"
    dataset = open_world(text)
    night = dataset.open("nominal_000007", (0, 100_000), SMALL)
    assert night.frames.mean() < 0.5 * plain.frames.mean()
    assert night.views[CROSS_LEFT].mean() < 0.5 * plain.views[CROSS_LEFT].mean()
    assert np.array_equal(night.reference.T_world_rig, plain.reference.T_world_rig)
    assert any("night" in note and "0.4" in note for note in dataset.drive("nominal_000007").notes)
    later = dataset.open("nominal_000007", (100_000, 100_000), SMALL)
    assert np.array_equal(later.frames[0], night.frames[1])


def test_values_that_change_nothing_give_the_same_images(open_world):
    plain = open_world().open("nominal_000007", (0, 0), SMALL)
    text = SPECIFICATION + "conditions: {light: day}\ncamera: {noise: 0.0}\n"
    assert np.array_equal(open_world(text).open("nominal_000007", (0, 0), SMALL).frames, plain.frames)


def test_true_views_carry_their_cameras(open_world):
    recording = open_world().open("nominal_000007", (0, 0), SMALL)
    assert recording.frames.shape == (1, 36, 64, 3)
    assert recording.mounted[CROSS_LEFT].camera.width == 64
    assert FRONT_WIDE not in recording.views


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("categories: [training/nothing]\nseed: 0\ncount: 1", "give each category once"),
        ("categories: [nominal]\nseed: 0\ncount: 1\ndisturbance: {}", "nominal cannot be disturbed"),
        ("categories: [training/nominal]\nseed: 0\ncount: 1\ndisturbance: {every: 1}", "disturbance.every: "),
        (
            "categories: [training/nominal]\nseed: 0\ncount: 1\ndisturbance: {blind: 0.7, hesitant: 0.6}",
            "disturbance: .*blind and hesitant are 1.3 together",
        ),
        ("categories: [training/nominal]\nseed: 0\ncount: 1\nduration: 21", "duration: "),
        ("categories: [animals]\nseed: 0\ncount: 1", "categories: .*give each category once, of nominal"),
        ("categories: [nominal, nominal]\nseed: 0\ncount: 1", "give each category once"),
        ("categories: []\nseed: 0\ncount: 1", "categories: "),
        ("categories: [nominal]\nseed: 0", "count: Field required"),
        ("categories: [nominal]\nseed: 0\ncount: 1\ncolour: red", "colour: Extra inputs"),
        ("categories: [nominal]\nseed: 0\ncount: 1\nduration: 15", "drives of nominal last 14 s"),
        ("categories: [nominal]\nseed: 0\ncount: 1\nframe_rate: 0", "frame_rate: "),
        ("categories: [nominal]\nseed: 0\ncount: 1\nconditions: {light: dusk}", "conditions.light: "),
        ("categories: [nominal]\nseed: 0\ncount: 1\nconditions: {fog: 1}", "conditions.fog: Extra inputs"),
        ("categories: [nominal]\nseed: 0\ncount: 1\ncamera: {drops: 2}", "camera.drops: "),
        ("[1, 2]", "is a mapping"),
        ("a: [", "not YAML"),
    ],
)
def test_a_wrong_file_is_refused(open_world, text, complaint):
    with pytest.raises(InputError, match=rf"synthetic\.yaml: .*{complaint}") as caught:
        open_world(text)
    assert "\n" not in str(caught.value)


def test_unknown_drives_and_empty_windows_are_refused(open_world):
    dataset = open_world()
    with pytest.raises(InputError, match="asks for no drive 'nominal_000001'"):
        dataset.drive("nominal_000001")
    with pytest.raises(InputError, match="no image lies between"):
        dataset.open("nominal_000007", (15_000_000, 16_000_000), SMALL)


def test_rear_views_made_by_looking_back_are_like_the_true_ones(open_world):
    """Six cameras of Alpamayo 2: what is marked as seen is close to the truth, and closer than what is invented."""
    cameras = find_contract("alpamayo-2").cameras
    dataset = open_world("categories: [nominal]\nseed: 3\ncount: 1\nduration: 3.0\n")
    recording = dataset.open("nominal_000003", (0, 3_000_000), OpenOptions(width=128, views=cameras))
    options = BuildOptions(128, 72, cameras=cameras, image_kind="rendered")
    true = build_clip(recording, replace(options, use_reference_views=True)).clip
    assert true.kind == "GT"
    assert tuple(true.streams) == cameras
    assert {view.kind for view in true.provenance.values()} == {"rendered"}
    np.testing.assert_array_equal(true.streams[REAR_LEFT].frames, recording.views[REAR_LEFT])

    made = build_clip(recording, replace(options, use_reference_motion=True))
    for rear in (REAR_LEFT, REAR_RIGHT):
        view = made.clip.provenance[rear]
        assert view.observed_share == view.other_times_share > 0.1
        assert made.view_errors[rear]["psnr_observed"] > made.view_errors[rear]["psnr"] + 2.0
        assert made.view_errors[rear]["psnr_observed"] > 18.0


def test_a_look_at_a_drive(open_world, check_peek):
    check_peek(open_world(SPECIFICATION + "duration: 0.5\n"), "nominal_000007", width=64, tolerance=0)
    coded = open_world(SPECIFICATION + "duration: 0.5\ncamera: {kilobits_per_second: 1000.0, noise: 4.0}\n")
    check_peek(coded, "nominal_000007", width=320, tolerance=15)


LEGS = """
categories: [training/gentle_bend]
seed: 1003
count: 1
disturbance: {every: 5.0, offset: 0.8}
"""


def test_drives_to_learn_from_take_turns_and_end_with_their_last_sample(open_world):
    dataset = open_world("categories: [training/work_zone, training/wye_merge]\nseed: 6\ncount: 2\n")
    assert dataset.keys() == [
        "training_lane_shift_000006",
        "training_lane_shift_on_curve_000007",
        "training_wye_merge_000006",
        "training_wye_merge_000007",
    ]
    drive = dataset.drive("training_lane_shift_000006")
    assert (drive.scene_id, drive.category, drive.take) == ("synthetic/training_lane_shift_000006", "work_zone", "")
    assert "cone_delineated_path" in drive.factors
    assert drive.front_us[-1] == 13_600_000 and drive.ego_span_us == (0, 20_000_000)


def test_a_disturbed_drive_comes_in_legs_of_one_scene(open_world):
    dataset = open_world(LEGS)
    drives = list(map(dataset.drive, dataset.keys()))
    assert [drive.key for drive in drives] == [f"training_gentle_bend_001003_leg_{leg}" for leg in range(len(drives))]
    assert len(drives) >= 2 and len({drive.take for drive in drives}) == len(drives)
    assert {drive.scene_id for drive in drives} == {"synthetic/training_gentle_bend_001003"}
    assert ["recovery" in drive.factors for drive in drives] == [False] + [True] * (len(drives) - 1)
    for drive in drives:
        assert drive.front_us[0] == 0 and drive.ego_span_us[0] <= 0
        assert drive.ego_span_us[1] >= drive.front_us[-1] + 6_400_000
    gentler = open_world(LEGS.replace("0.8", "0.5"))
    assert gentler.drive(drives[1].key).take != drives[1].take


def test_the_clip_of_a_leg_knows_its_route_and_what_is_around(open_world):
    dataset = open_world(LEGS)
    key = dataset.keys()[1]
    drive, scene = dataset.drive(key), dataset._find(key).scene()
    start_us = -drive.ego_span_us[0]
    recording = dataset.open(key, (0, 1_700_000), SMALL)
    shown = record_drive(scene, 64, 36, 10.0, (CROSS_LEFT,), window_us=(start_us, start_us + 1_700_000))
    np.testing.assert_allclose(recording.reference.T_world_rig, shown.reference.T_world_rig)
    clip = build_clip(recording, BuildOptions(64, 36, cameras=(CROSS_LEFT, FRONT_WIDE), use_reference_views=True)).clip
    # The route in the world again.
    T_world_rig = scene.ego.interpolate(np.array([start_us]))[0]
    anchor = planar_pose(T_world_rig[0, 3], T_world_rig[1, 3], float(yaw_of(T_world_rig)))
    lifted = np.column_stack([clip.route, np.zeros(len(clip.route))])
    np.testing.assert_allclose(transform(anchor, lifted)[:, :2], scene.route[:, :2], atol=1e-6)
    assert clip.holds is not None and clip.holds.timestamps_us[0] == 0
    assert clip.obstacles is not None and clip.obstacles.boxes.shape[1] == 7


def test_images_do_not_tell_which_leg_they_are_of(open_world):
    """Who films changes nothing of the world: the same pose at the same time gives the same image."""
    plain = open_world("categories: [training/gentle_bend]\nseed: 1003\ncount: 1\n")
    whole = plain.open("training_gentle_bend_001003", (0, 500_000), SMALL)
    first = open_world(LEGS).open("training_gentle_bend_001003_leg_0", (0, 500_000), SMALL)
    assert np.array_equal(whole.frames, first.frames)


def test_a_rendered_image_has_the_shape_that_is_asked_for(open_world):
    recording = open_world().open("nominal_000007", (0, 0), replace(SMALL, height=40))
    assert recording.frames.shape == (1, 40, 64, 3)
