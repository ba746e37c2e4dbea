"""Samples that are decoded by another process while training goes on."""

import multiprocessing
import os
import signal
import time
from functools import partial

import numpy as np
import pytest

from olt_generator.errors import InputError
from olt_sft_recipes.training import sample_arrays
from olt_sft_recipes.training.driving_samples import DrivingSamples
from olt_sft_recipes.training.sample_arrays import SampleArrays, bytes_of_sample
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.status import read_statuses
from olt_sft_recipes.training.two_stages import train_two_stages

SETTINGS = {"num_train_epochs": 1, "per_device_train_batch_size": 4, "warmup_steps": 0}


@pytest.fixture(autouse=True)
def _always_another_process(monkeypatch):
    monkeypatch.setattr(sample_arrays, "_SECONDS_TO_START", -1.0)
    monkeypatch.setattr(sample_arrays, "_AT_ONCE", 1)


def load(samples, told, keys):
    """Tells which process loads."""
    with told.open("a") as file:
        file.write(f"{os.getpid()}\n")
    return [samples[key] for key in keys]


def load_but_one(samples, keys):
    for key in keys:
        if key.clip_id == "clip07":
            raise InputError("store/camera.zip: clip07.mp4: the video cannot be decoded; build the clip again")
    return [samples[key] for key in keys]


def load_and_die(samples, keys):
    if multiprocessing.parent_process() is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    return [samples[key] for key in keys]


def train(load_samples, keys, config, out):
    train_two_stages(
        (StageConfig(stage=1, **SETTINGS), StageConfig(stage=2, **SETTINGS)),
        lambda _, size: [keys[start : start + size] for start in range(0, len(keys), size)],
        load_samples,
        out,
        config,
        workers=1,
    )


def test_another_process_decodes_the_same_and_ends(drives, tiny_config, tmp_path):
    keys, told, others = sorted(drives), tmp_path / "told", set(multiprocessing.active_children())
    with SampleArrays(keys, partial(load, drives, told), tiny_config, tmp_path / "samples", workers=1) as samples:
        samples.open([[3], [8, 1]])
        assert told.read_text().split() == [str(os.getpid())]  # what is wanted first is not waited for
        until = time.monotonic() + 120
        while len(set(told.read_text().split())) < 2 and time.monotonic() < until:
            time.sleep(0.1)
        found = samples.having(range(len(keys)))
        expected = DrivingSamples.gather([drives[key] for key in keys], tiny_config)
        for name, values in vars(expected).items():
            np.testing.assert_array_equal(getattr(found, name), values)
    loaded = told.read_text().split()
    assert len(loaded) == len(keys) and len(set(loaded)) == 2
    assert not set(multiprocessing.active_children()) - others
    assert (tmp_path / "samples/samples.json").exists()


def test_the_space_of_all_samples_is_taken_before_the_first_step(drives, tiny_config, tmp_path):
    """On a disk that fills up later the system would end the process, without a word, where it writes to a map."""
    keys, folder = sorted(drives) * 20, tmp_path / "samples"
    with SampleArrays(keys, partial(load, drives, tmp_path / "told"), tiny_config, folder) as samples:
        samples.open([[3]])
        files = [path.stat() for path in folder.glob("*.npy")]
        assert all(file.st_blocks * 512 >= file.st_size for file in files)
        headers = 128 * len(files)
        assert sum(file.st_size for file in files) - headers == len(keys) * bytes_of_sample(tiny_config)


def test_a_disk_without_room_for_the_samples_is_told_in_words(drives, tiny_config, tmp_path, full_disk):
    keys, folder = sorted(drives), tmp_path / "samples"
    with (
        full_disk(10_000),
        pytest.raises(InputError, match=r"images\.npy: cannot be written .*; free some space or"),
        SampleArrays(keys, partial(load, drives, tmp_path / "told"), tiny_config, folder) as samples,
    ):
        samples.open([[3]])
    assert not folder.exists()


def test_a_damaged_clip_ends_the_training_wherever_it_is_decoded(drives, tiny_config, tmp_path):
    others = set(multiprocessing.active_children())
    with pytest.raises(InputError, match=r"store/camera.zip: clip07.mp4"):
        train(partial(load_but_one, drives), sorted(drives), tiny_config, tmp_path / "out")
    status = read_statuses(tmp_path / "out")[0]
    assert status.phase == "stopped" and "clip07.mp4" in str(status.why)
    assert not (tmp_path / "out/samples").exists()
    assert not set(multiprocessing.active_children()) - others


def test_a_process_that_is_killed_ends_the_training(drives, tiny_config, tmp_path):
    others = set(multiprocessing.active_children())
    with pytest.raises(InputError, match="a process that decodes samples was ended"):
        train(partial(load_and_die, drives), sorted(drives), tiny_config, tmp_path / "out")
    assert not (tmp_path / "out/samples").exists()
    assert not set(multiprocessing.active_children()) - others
