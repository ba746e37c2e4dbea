"""A training that goes on in a folder which is damaged, half written, or of other samples, settings or stages."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.torch import load_file, save_file

from olt_generator.errors import InputError
from olt_sft_recipes.toy.checkpoint import read_model
from olt_sft_recipes.training.sample_arrays import name_by_key
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.status import StageStatus, read_statuses, write_status
from olt_sft_recipes.training.two_stages import train_two_stages
from olt_sft_recipes.training.validation import Validation

SETTINGS = {"num_train_epochs": 1, "per_device_train_batch_size": 4, "warmup_steps": 0, "learning_rate": 1e-3}
STAGES = tuple(StageConfig(stage=stage, save_steps=1, **SETTINGS) for stage in (1, 2))
SHARD = "model-00001-of-00001.safetensors"


@pytest.fixture
def train(drives, tiny_config):
    """Train both stages, three steps each, into a folder."""
    keys = sorted(drives)

    def batches(_, size):
        return [keys[start : start + size] for start in range(0, len(keys), size)]

    def run(out, first=STAGES[0], second=STAGES[1], load=lambda asked: [drives[key] for key in asked], **further):
        config = further.pop("config", tiny_config)
        return train_two_stages((first, second), further.pop("batches", batches), load, out, config, **further)

    return run


@pytest.fixture(scope="module")
def made_once(tmp_path_factory):
    return tmp_path_factory.mktemp("made")


@pytest.fixture
def whole(train, made_once, tmp_path):
    """Results of a training that came to its end, and a copy of its folder."""
    if not (made_once / "whole").exists():
        train(made_once / "whole")
    out = Path(shutil.copytree(made_once / "whole", tmp_path / "whole"))
    return train(out), out


@pytest.fixture
def broken_off(train, made_once, tmp_path):
    """A copy of the folder of a training that was broken off after two steps of Stage 1."""

    def break_off(share):
        if share > 0.3:
            raise KeyboardInterrupt

    if not (made_once / "broken off").exists():
        with pytest.raises(KeyboardInterrupt):
            train(made_once / "broken off", on_progress=break_off)
    return Path(shutil.copytree(made_once / "broken off", tmp_path / "broken off"))


def weights(out):
    return (out / "policy" / SHARD).read_bytes()


def set_status(folder, **fields):
    """The status of a stage as a process left it that was killed."""
    content = json.loads((folder / "status.json").read_text())
    (folder / "status.json").write_text(json.dumps({**content, **fields, "process_start": "1"}))


def test_other_samples_of_the_same_names_are_trained_on_anew(train, whole, drives):
    others = {key: replace(sample, image_frames=255 - sample.image_frames) for key, sample in drives.items()}
    load = lambda asked: [others[key] for key in asked]  # noqa: E731
    results, out = whole
    assert [result.losses for result in train(out, load=load)] == [result.losses for result in results]
    again = train(out, load=load, name_sample=lambda key: f"other {name_by_key(key)}")
    assert again[0].losses != results[0].losses


def test_samples_that_judge_are_told_by_what_they_hold(drives):
    sample = next(iter(drives.values()))
    other = replace(sample, image_frames=255 - sample.image_frames)
    assert Validation([sample]).identity(1) == Validation([replace(sample)]).identity(1)
    assert Validation([sample]).identity(1) != Validation([other]).identity(1)


@pytest.mark.parametrize("setting", [{"sight_weight": 0.0}, {"invented_pixel_weight": 0.5}])
def test_samples_that_were_loaded_for_other_settings_are_loaded_again(train, broken_off, drives, setting):
    asked = []

    def load(keys):
        asked.extend(keys)
        return [drives[key] for key in keys]

    assert (broken_off / "samples/samples.json").exists()
    train(broken_off, STAGES[0].model_copy(update={"learning_rate": 2e-3, **setting}), load=load)
    assert sorted(asked) == sorted(drives)


def test_only_the_samples_of_a_stage_decide_it(train, drives, tmp_path):
    keys = sorted(drives)
    batches = lambda epoch, size: [keys[4 * epoch : 4 * epoch + 4]]  # noqa: E731
    first = STAGES[0].model_copy(update={"num_train_epochs": 2})
    results = train(tmp_path, first, batches=batches)
    assert train(tmp_path, first, batches=batches, only="2") == results[1:]


def test_killed_after_its_last_step_a_training_is_told_as_finished(train, whole):
    _, out = whole
    for stage in ("stage1", "stage2"):
        set_status(out / stage, phase="training")
        (out / stage / "curves.png").unlink()
    train(out)
    assert [status.phase for status in read_statuses(out)] == ["finished", "finished"]
    assert all((out / stage / "curves.png").exists() for stage in ("stage1", "stage2"))


def test_why_a_training_is_not_gone_on_with_is_told(train, broken_off):
    def refuse(_):
        raise InputError("store: no clip of this name")

    set_status(broken_off / "stage1", phase="training", step=2)
    assert "dead" in read_statuses(broken_off)[0].describe()
    with pytest.raises(InputError, match="no clip"):
        train(broken_off, name_sample=refuse)
    status = read_statuses(broken_off)[0]
    assert (status.step, status.describe()) == (2, "stopped: store: no clip of this name")


def test_what_was_made_from_a_stage_goes_when_it_is_trained_anew(train, whole):
    _, out = whole
    train(out, second=STAGES[1].model_copy(update={"seed": 5}), only="1")
    assert (out / "policy").exists()
    train(out, STAGES[0].model_copy(update={"seed": 5}), only="1")
    assert [status.stage for status in read_statuses(out)] == [1]
    assert not (out / "stage2").exists() and not (out / "policy").exists()


def test_stage_2_of_another_model_than_stage_1_is_refused(train, whole, tiny_config):
    _, out = whole
    config = tiny_config.model_copy(update={"rig": "alpamayo-2"})
    with pytest.raises(InputError, match=r"stage1: Stage 1 has rig alpamayo-r1 instead of alpamayo-2; .*--rig"):
        train(out, config=config, only="2")


def flip_bit(path):
    content = bytearray(path.read_bytes())
    content[-5] ^= 1
    path.write_bytes(content)


def halve(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        (SHARD, halve),
        (SHARD, flip_bit),
        ("optimizer.safetensors", flip_bit),
        ("config.json", lambda path: path.write_bytes(b"")),
        ("trainer_state.json", lambda path: path.write_bytes(b"")),
        ("model.safetensors.index.json", Path.unlink),
    ],
)
def test_a_damaged_checkpoint_is_told_and_training_goes_on_before_it(train, whole, broken_off, name, damage):
    last = broken_off / "stage1/checkpoint-2"
    damage(last / name)
    with pytest.raises(InputError, match=rf"{name}.*; remove {last} .*goes on before it"):
        train(broken_off)
    assert "remove" in read_statuses(broken_off)[0].describe()
    shutil.rmtree(last)
    assert [result.losses for result in train(broken_off)] == [result.losses for result in whole[0]]
    assert weights(broken_off) == weights(whole[1])


def test_a_damaged_stage_1_is_not_handed_over(train, whole):
    _, out = whole
    flip_bit(out / "stage1/checkpoint-3" / SHARD)
    with pytest.raises(InputError, match="is not as it was written"):
        train(out, only="2")


def test_weights_that_are_not_finite_do_not_load(whole):
    _, out = whole
    tensors = load_file(out / "policy" / SHARD)
    next(iter(tensors.values())).fill_(np.nan)
    save_file(tensors, out / "policy" / SHARD)
    with pytest.raises(InputError, match="not finite"):
        read_model(out / "policy")


def test_a_checkpoint_is_on_the_disk_before_it_has_its_name(train, tmp_path, monkeypatch):
    synced, real = set(), os.fsync

    def fsync(handle):
        synced.add(Path(os.readlink(f"/proc/self/fd/{handle}")).name)
        real(handle)

    monkeypatch.setattr("olt_generator.files.os.fsync", fsync)
    train(tmp_path, only="1")
    assert synced >= {path.name for path in (tmp_path / "stage1/checkpoint-3").iterdir()} | {"stage1"}


def test_what_killed_processes_left_half_written_goes(train, whole):
    _, out = whole
    for folder in ("stage1/.checkpoint-9.abcd", "stage2/.checkpoint-1.removed", ".policy.abcd"):
        (out / folder / "part").mkdir(parents=True)
    (out / "stage1/checkpoint-3/.trainer_state.abcd.json").touch()
    train(out)
    assert [path.name for path in out.rglob(".*")] == [".lock"]
    (out / "policy").rename(out / ".policy.replaced")
    train(out)
    assert read_model(out / "policy")


def test_a_finished_stage_stays_so_where_it_cannot_be_looked_at(train, whole):
    def refuse(_):
        raise InputError("store: no clip of this name")

    write_status(whole[1] / "stage2", StageStatus(2, "training", 1, 3))
    with pytest.raises(InputError, match="no clip"):
        train(whole[1], name_sample=refuse)
    assert [status.phase for status in read_statuses(whole[1])] == ["finished", "stopped"]
