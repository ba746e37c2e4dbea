import json
from collections import Counter

import av
import numpy as np
import pandas as pd
import pytest

from olt_datasets.export.contents import contents_of_stores
from olt_datasets.export.image_sizes import parse_size
from olt_datasets.export.lerobot import export_lerobot, frame_times
from olt_generator.errors import InputError
from olt_toolkit.clips.clip import make_clip_id
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.policy.sample import SampleKey
from olt_toolkit.rigs.rig import POLICY_CAMERAS

SIZE = (36, 64)
ONE_SIZE = "64x36"
A, B, C, D, E = (make_clip_id(name) for name in "abcde")


class FormatReader:
    """A data set read by the documented rules of LeRobot's format 3.0, with none of the code that wrote it."""

    def __init__(self, root):
        self.root = root
        self.info = json.loads((root / "meta/info.json").read_text())
        self.stats = json.loads((root / "meta/stats.json").read_text())
        self.tasks = pd.read_parquet(root / "meta/tasks.parquet")
        self.episodes = pd.concat(map(pd.read_parquet, sorted(root.glob("meta/episodes/*/*.parquet"))))
        self.frames = pd.concat(map(pd.read_parquet, sorted(root.glob("data/*/*.parquet"))), ignore_index=True)

    def image(self, index, key):
        """The frame of a video whose time is that of a row, to within LeRobot's tolerance of 0.1 ms."""
        row = self.frames.iloc[index]
        episode = self.episodes.iloc[row["episode_index"]]
        path = self.info["video_path"].format(
            video_key=key,
            chunk_index=episode[f"videos/{key}/chunk_index"],
            file_index=episode[f"videos/{key}/file_index"],
        )
        wanted = episode[f"videos/{key}/from_timestamp"] + float(row["timestamp"])
        with av.open(str(self.root / path)) as container:
            for frame in container.decode(video=0):
                if abs(frame.time - wanted) < 1e-4:
                    return frame.to_ndarray(format="rgb24")
        raise AssertionError(f"no frame at {wanted} s in {path}")


@pytest.fixture(scope="module")
def exported(stores, tmp_path_factory):
    out = tmp_path_factory.mktemp("lerobot") / "set"
    return export_lerobot(contents_of_stores(stores, "train"), out), out


@pytest.fixture(scope="module")
def reader(exported):
    return FormatReader(exported[1])


def test_tables_agree_with_the_format(reader):
    info, frames, episodes = reader.info, reader.frames, reader.episodes
    assert info["codebase_version"] == "v3.0" and info["fps"] == 10 and info["splits"] == {"train": "0:5"}
    assert (info["total_frames"], info["total_episodes"], info["total_tasks"]) == (len(frames), 5, 2)
    assert frames["index"].tolist() == list(range(len(frames)))
    for number, episode in enumerate(episodes.to_dict("records")):
        rows = frames.iloc[episode["dataset_from_index"] : episode["dataset_to_index"]]
        assert (rows["episode_index"] == number).all() and len(rows) == episode["length"]
        assert rows["frame_index"].tolist() == list(range(len(rows)))
        np.testing.assert_array_equal(rows["timestamp"], (np.arange(len(rows)) / 10).astype(np.float32))
        assert reader.tasks.index[rows["task_index"].iloc[0]] == episode["tasks"][0]
        assert episode["data/chunk_index"] == episode["data/file_index"] == 0
    for name, feature in info["features"].items():
        assert "/" not in name and (feature["names"] is None or len(feature["names"]) in (feature["shape"][0], 3))
        if feature["dtype"] != "video":
            values = np.stack(frames[name]) if frames[name].dtype == object else frames[name].to_numpy()
            assert list(values.shape[1:] or (1,)) == feature["shape"] and str(values.dtype) == feature["dtype"]


def test_frames_are_the_sample_times_and_the_images_before_them(reader, exported):
    summary, _ = exported
    # Ego motion begins at 0 s and a state needs 1.5 s of it: the frame at 1.4 s is missing.
    assert reader.episodes["start_us"].tolist() == [1_500_000] * 5 and (reader.episodes["length"] == 7).all()
    assert reader.frames.groupby("episode_index")["is_sample"].sum().tolist() == [5] * 5
    assert summary["samples"] == 25 and summary["frames"] == 35
    assert "5 samples have fewer than three frames before them" in summary["notes"][0]


def test_images_and_poses_are_those_of_the_samples(reader, stores):
    for index in (2, 6, 27):
        row = reader.frames.iloc[index]
        episode = reader.episodes.iloc[row["episode_index"]]
        store = stores[0] if episode["kind"] == "GT" else stores[1]
        t0_us = int(episode["start_us"] + 1e5 * row["frame_index"])
        sample = ClipStore(store).load_sample(SampleKey(str(store), episode["clip_id"], t0_us))
        for camera, images in zip(POLICY_CAMERAS, sample.image_frames, strict=True):
            image = reader.image(index, f"observation.images.{camera}")
            np.testing.assert_allclose(image.transpose(2, 0, 1), images[-1], atol=2)
        for column, name, steps in (("observation.state", "history", 16), ("action", "future", 64)):
            poses = row[column].reshape(steps, 4)
            np.testing.assert_allclose(poses[:, :3], getattr(sample, f"ego_{name}_xyz")[0], atol=1e-5)
            rotation = getattr(sample, f"ego_{name}_rot")[0]
            np.testing.assert_allclose(poses[:, 3], np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]), atol=1e-5)


def test_statistics_are_those_of_the_data(reader):
    values = np.stack(reader.frames["action"])
    for name in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(reader.stats["action"][name], getattr(np, name)(values, axis=0), atol=1e-5)
    key = f"observation.images.{POLICY_CAMERAS[1]}"
    pixels = np.stack([reader.image(index, key) for index in range(len(reader.frames))]).reshape(-1, 3) / 255
    for name in ("min", "max", "mean", "std"):
        found = np.array(reader.stats[key][name])
        assert found.shape == (3, 1, 1)
        np.testing.assert_allclose(found.ravel(), getattr(np, name)(pixels, axis=0), atol=0.01)
    np.testing.assert_allclose(np.ravel(reader.stats[key]["q50"]), np.median(pixels, axis=0), atol=0.01)
    assert reader.stats[key]["count"] == [35]


def test_images_keep_their_size_or_tell_it(exported, reader, stores, tmp_path):
    summary, _ = exported
    assert set(summary["image_sizes"].values()) == {ONE_SIZE} and summary["resized_from"] == {}
    videos = [feature for feature in reader.info["features"].values() if feature["dtype"] == "video"]
    assert all(video["shape"] == [*SIZE, 3] and "video.resized_from" not in video["info"] for video in videos)

    out = tmp_path / "small"
    small = export_lerobot(contents_of_stores([stores[1]], "train"), out, image_size=(18, 32))
    assert set(small["image_sizes"].values()) == {"32x18"}
    assert small["resized_from"] == {camera: {ONE_SIZE: 2} for camera in POLICY_CAMERAS}
    feature = FormatReader(out).info["features"][f"observation.images.{POLICY_CAMERAS[0]}"]
    assert feature["shape"] == [18, 32, 3] and feature["info"]["video.resized_from"] == {ONE_SIZE: 2}


def test_sizes_that_differ_are_refused_unless_one_is_asked_for(stores, tmp_path, monkeypatch):
    from olt_datasets.export import image_sizes, lerobot

    contents = contents_of_stores([stores[0]], "train")
    true_sizes = image_sizes.read_image_sizes(contents)
    assert true_sizes == {camera: {SIZE: 3} for camera in POLICY_CAMERAS}
    true_sizes[POLICY_CAMERAS[1]] += Counter({(1080, 1920): 2})
    monkeypatch.setattr(lerobot, "read_image_sizes", lambda _: true_sizes)
    message = f"{POLICY_CAMERAS[1]}: images of {ONE_SIZE} in 3 clips, 1920x1080 in 2 clips, .*give --image-size"
    with pytest.raises(InputError, match=message):
        export_lerobot(contents, tmp_path / "set")
    assert list(tmp_path.iterdir()) == []
    summary = export_lerobot(contents, tmp_path / "set", image_size=SIZE)
    assert summary["resized_from"] == {POLICY_CAMERAS[1]: {"1920x1080": 2}}


@pytest.mark.parametrize("text", ["576", "575x320", "576x", "0x0", "-2x4", "axb", "576x320x3"])
def test_sizes_that_are_none_are_refused(text):
    with pytest.raises(InputError, match="write WIDTHxHEIGHT in pixels"):
        parse_size(text)


def test_times_without_a_state_and_gaps_are_kept_apart():
    times = frame_times((3_000_000, 3_100_000, 5_000_000, 5_050_000), ego_start_us=0)
    assert times.tolist() == [
        *range(2_700_000, 3_100_001, 100_000),
        *range(4_700_000, 5_000_001, 100_000),
        *range(4_750_000, 5_050_001, 100_000),
    ]


def test_an_interrupted_export_goes_on(stores, tmp_path, monkeypatch):
    from olt_datasets.export import lerobot

    contents, out = contents_of_stores([stores[1]], "train"), tmp_path / "set"
    write_video, calls = lerobot.write_video, []

    def write(path, frames, rate):
        calls.append(path)
        if len(calls) == 6:
            raise KeyboardInterrupt
        write_video(path, frames, rate)

    monkeypatch.setattr(lerobot, "write_video", write)
    with pytest.raises(KeyboardInterrupt):
        export_lerobot(contents, out, image_size=SIZE)
    assert not out.exists()
    summary = export_lerobot(contents, out, image_size=SIZE)
    assert len(calls) == 6 + 4, "the first clip was not encoded again"
    assert summary["clips"] == 2 and len(FormatReader(out).episodes) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["set"]


def test_a_full_disk_names_the_file(stores, tmp_path, full_disk):
    message = r"camera_cross_left_120fov/.*\.mp4: cannot be written \(File too large"
    with pytest.raises(InputError, match=message), full_disk(1000):
        export_lerobot(contents_of_stores(stores, "train"), tmp_path / "set", image_size=SIZE)


@pytest.mark.slow
def test_lerobot_itself_reads_the_tables(exported, reader):
    datasets = pytest.importorskip("lerobot.datasets.lerobot_dataset", reason="lerobot is not installed")
    data = datasets.LeRobotDataset("test/set", root=exported[1])
    assert data.num_episodes == 5 and data.num_frames == len(reader.frames)
    assert data.meta.stats["action"]["mean"].shape == (256,)
    for index, row in enumerate(data.hf_dataset):
        np.testing.assert_array_equal(row["observation.state"], reader.frames["observation.state"][index])
