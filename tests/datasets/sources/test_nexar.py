"""Nexar's dashcam videos as a data set."""

import csv

import numpy as np
import pytest

from olt_generator.errors import InputError
from olt_generator.video import write_video
from olt_toolkit import OpenOptions
from olt_toolkit.recordings.drives import open_dataset


def write(path, frames=12, rate=10):
    path.parent.mkdir(parents=True, exist_ok=True)
    levels = 15 * np.arange(frames, dtype=np.uint8)
    write_video(path, np.tile(levels[:, None, None, None], (1, 36, 64, 3)), rate)
    return path


def write_table(path, rows):
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, fieldnames=list(rows[0]))
        table.writeheader()
        table.writerows(rows)


CHALLENGE = [
    {"id": "00022", "time_of_event": "0.9", "time_of_alert": "0.75", "target": "1"},
    {"id": "01337", "time_of_event": "", "time_of_alert": "", "target": "0"},
    {"id": "00003", "time_of_event": "1.0", "time_of_alert": "nan", "target": "1"},
]


def write_challenge(root):
    write_table(root / "train.csv", CHALLENGE)
    write_table(root / "test.csv", [{"id": "00007"}])
    for name in ("train/00022", "train/01337", "train/00003", "test/00007"):
        write(root / f"{name}.mp4")
    return root


@pytest.fixture
def challenge(tmp_path):
    return write_challenge(tmp_path / "challenge")


def test_the_layout_of_the_challenge(challenge, tmp_path):
    dataset = open_dataset(challenge, tmp_path / "cache")
    assert dataset.source == "nexar"
    assert dataset.keys() == ["test/00007", "train/00003", "train/00022", "train/01337"]
    drive = dataset.drive("train/00022")
    assert drive.scene_id == "nexar/train/00022"
    assert drive.split == "train"
    assert drive.front_us.tolist() == [100_000 * k for k in range(12)]
    assert drive.category == "unlabelled"
    assert drive.country is None
    assert dataset.open("train/00022", (0, 200_000), OpenOptions()).source == "nexar"


def test_videos_of_one_id_in_a_split_are_refused(tmp_path):
    rows = [{"file_name": "positive/00022.mp4"}, {"file_name": "negative/00022.mp4"}]
    write_table(tmp_path / "train" / "metadata.csv", rows)
    with pytest.raises(InputError, match=r"line 3: train/negative/00022 and train/positive/00022 have one id"):
        open_dataset(tmp_path, tmp_path / "cache")


def test_what_leads_to_a_collision_ends_before_the_alert(challenge, tmp_path):
    dataset = open_dataset(challenge, tmp_path / "cache")
    assert dataset.drive("train/00022").usable_us == (0, 749_999)
    assert dataset.drive("train/00003").usable_us == (0, 999_999)
    assert any("before the event" in note for note in dataset.drive("train/00003").notes)
    assert dataset.drive("train/01337").usable_us is None
    test = dataset.drive("test/00007")
    assert test.split == "test"
    assert any("not told" in note for note in test.notes)


def test_the_layout_of_the_hub(tmp_path):
    root = tmp_path / "hub"
    tells = {"light_conditions": "Dark", "weather": "Rain", "scene": "Sub-urban", "time_to_accident": ""}
    write_table(
        root / "train" / "positive" / "metadata.csv",
        [{"file_name": "00022.mp4", "time_of_event": "1.0", "time_of_alert": "0.5"} | tells],
    )
    write_table(
        root / "train" / "negative" / "metadata.csv",
        [{"file_name": "00001.mp4", "time_of_event": "", "time_of_alert": ""} | tells | {"weather": ""}],
    )
    write_table(
        root / "test-public" / "metadata.csv",
        [{"file_name": "positive/00022.mp4", "time_of_event": "1.5", "time_of_alert": "1.0"} | tells],
    )
    for name in ("train/positive/00022", "train/negative/00001", "test-public/positive/00022"):
        write(root / f"{name}.mp4")
    dataset = open_dataset(root, tmp_path / "cache")
    assert dataset.source == "nexar"
    assert dataset.keys() == ["test-public/positive/00022", "train/negative/00001", "train/positive/00022"]
    positive, negative = dataset.drive("train/positive/00022"), dataset.drive("train/negative/00001")
    assert positive.factors == ("light_dark", "weather_rain", "scene_sub_urban")
    assert positive.usable_us == (0, 499_999)
    assert positive.scene_id == "nexar/train/00022"
    assert negative.factors == ("light_dark", "scene_sub_urban")
    assert negative.usable_us is None
    assert dataset.drive("test-public/positive/00022").scene_id == "nexar/test/00022"


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"target": "yes"}, r"train\.csv, line 2: target 'yes'"),
        ({"time_of_alert": "soon"}, r"line 2: time_of_alert 'soon'"),
        ({"time_of_alert": "-1"}, r"line 2: time_of_alert -1\.0"),
        ({"id": ""}, r"line 2: neither 'id' nor 'file_name'"),
        ({"id": "../../secret"}, r"line 2: neither 'id' nor 'file_name'"),
        ({"id": "01337"}, r"line 3: video train/01337 is listed twice"),
    ],
)
def test_a_wrong_row_is_named(challenge, tmp_path, change, complaint):
    write_table(challenge / "train.csv", [CHALLENGE[0] | change, *CHALLENGE[1:]])
    with pytest.raises(InputError, match=complaint):
        open_dataset(challenge, tmp_path / "cache")


def test_a_listed_video_that_is_missing_or_ends_nobody_knows_when(challenge, tmp_path):
    rows = [*CHALLENGE, {"id": "00004", "target": "1"} | dict.fromkeys(("time_of_event", "time_of_alert"), "")]
    write_table(challenge / "train.csv", rows)
    dataset = open_dataset(challenge, tmp_path / "cache")
    with pytest.raises(InputError, match=r"00004\.mp4: no such video file"):
        dataset.drive("train/00004")
    write(challenge / "train" / "00004.mp4")
    with pytest.raises(InputError, match="no time_of_alert or time_of_event"):
        dataset.drive("train/00004")


def test_a_look_at_a_video(challenge, tmp_path, check_peek):
    check_peek(open_dataset(challenge, tmp_path / "cache"), "train/01337")
