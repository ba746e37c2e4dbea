"""What a training leaves in its folder, and what it does with data that is small, large or bad."""

import json
import os
import shutil
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

from olt_generator.errors import InputError
from olt_sft_recipes.toy.checkpoint import ToyModel, read_model, read_tensors, save_model
from olt_sft_recipes.toy.policy import load_toy
from olt_sft_recipes.training import validation as judging
from olt_sft_recipes.training.checkpoints import hash_tensors
from olt_sft_recipes.training.driving_samples import DrivingSamples
from olt_sft_recipes.training.sample_arrays import SampleArrays
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.status import StageStatus, read_statuses, write_status
from olt_sft_recipes.training.two_stages import train_stage, train_two_stages
from olt_sft_recipes.training.validation import Validation
from olt_toolkit.runtime.command_line import run

STAGE_1 = StageConfig(stage=1, num_train_epochs=1, per_device_train_batch_size=4, warmup_steps=0, learning_rate=1e-3)
STAGE_2 = StageConfig(stage=2, num_train_epochs=1, per_device_train_batch_size=4, warmup_steps=0, learning_rate=1e-3)


def train_both(drives, config, out, first=STAGE_1, second=STAGE_2, **further):
    """Both stages, three steps each."""
    keys = sorted(drives)

    def batches(epoch, size):
        return [keys[start : start + size] for start in range(0, len(keys), size)]

    load = further.pop("load", lambda asked: [drives[key] for key in asked])
    return train_two_stages((first, second), batches, load, out, config, **further)


@pytest.fixture(scope="module")
def trained(drives, tiny_config, tmp_path_factory):
    """Both stages, three steps each: results and folder."""
    out = tmp_path_factory.mktemp("trained")
    return train_both(drives, tiny_config, out), out


@pytest.fixture
def copied(trained, tmp_path):
    """A copy of that folder."""
    return Path(shutil.copytree(trained[1], tmp_path / "copied"))


def train_one(stage, samples, out, config, steps, **further):
    """One stage on samples by key, a list of keys for each step."""
    return train_stage(
        stage, lambda *_: steps, lambda keys: [samples[key] for key in keys], None, out, config, **further
    )


def test_stage_2_ends_with_the_bytes_of_stage_1(trained):
    results, out = trained
    before, after = read_model(out / "stage1/checkpoint-3"), read_model(out / "stage2/checkpoint-3")
    assert hash_tensors(before.vlm) == hash_tensors(after.vlm) == results[1].vlm_sha256
    assert hash_tensors(before.expert) != hash_tensors(after.expert)
    assert results[0].vlm_sha256 is None


def test_a_model_that_changes_in_stage_2_ends_the_training(trained, drives, tiny_config, tmp_path, monkeypatch):
    from olt_sft_recipes.training import optimization

    real = optimization.sample_losses

    def meddle(model, *arguments):
        with torch.no_grad():
            model.vlm.positions += 1e-7
        return real(model, *arguments)

    monkeypatch.setattr(optimization, "sample_losses", meddle)
    keys = sorted(drives)
    with pytest.raises(RuntimeError, match="frozen"):
        train_stage(
            STAGE_2,
            lambda *_: [keys[:4]],
            lambda asked: [drives[key] for key in asked],
            trained[1] / "stage1/checkpoint-3",
            tmp_path / "out",
        )
    assert not list((tmp_path / "out").glob("checkpoint-*"))


def test_checkpoints_drive_by_path(trained, drives):
    _, out = trained
    for folder in (out / "policy", out / "stage2/checkpoint-3"):
        assert load_toy(str(folder)).cameras


def test_weights_are_divided_and_joined(tiny_config, tmp_path):
    model = ToyModel(tiny_config)
    save_model(tmp_path / "m", model, shard_bytes=20_000)
    files = sorted(path.name for path in (tmp_path / "m").glob("*.safetensors"))
    assert len(files) > 3 and files[0] == f"model-00001-of-{len(files):05d}.safetensors"
    index = json.loads((tmp_path / "m/model.safetensors.index.json").read_text())
    assert set(index["weight_map"].values()) == set(files)
    assert index["metadata"]["total_size"] == sum(4 * tensor.numel() for tensor in model.state_dict().values())
    back = read_tensors(tmp_path / "m")
    assert all(torch.equal(back[name], tensor) for name, tensor in model.state_dict().items())


@pytest.mark.parametrize(
    ("damage", "match"),
    [
        (lambda where: where.update(dict.fromkeys(where, "../model.safetensors")), "no file of this folder"),
        (lambda where: where.clear(), "names no tensors"),
        (lambda where: where.popitem(), "does not hold the tensors"),
        (lambda where: where.update({"vlm.other": next(iter(where.values()))}), "does not hold the tensors"),
        (lambda where: where.update({"vlm.other": "model-9.safetensors"}), "cannot read these weights"),
    ],
)
def test_an_index_that_is_wrong_is_refused(tiny_config, tmp_path, damage, match):
    save_model(tmp_path / "m", ToyModel(tiny_config))
    path = tmp_path / "m/model.safetensors.index.json"
    index = json.loads(path.read_text())
    damage(index["weight_map"])
    path.write_text(json.dumps(index))
    with pytest.raises(InputError, match=match):
        read_model(tmp_path / "m")


def test_a_single_file_of_earlier_releases_is_read(tiny_config, tmp_path):
    model = ToyModel(tiny_config)
    save_model(tmp_path / "m", model)
    (tmp_path / "m/model.safetensors.index.json").unlink()
    (tmp_path / "m/model-00001-of-00001.safetensors").rename(tmp_path / "m/model.safetensors")
    assert hash_tensors(read_model(tmp_path / "m")) == hash_tensors(model)


def test_samples_are_decoded_once_when_they_are_wanted_and_mapped(drives, tiny_config, tmp_path):
    keys = sorted(drives)
    many = [replace(key, t0_us=moment) for key in keys for moment in range(9)]
    asked = []

    def load(wanted):
        asked.extend(wanted)
        return [drives[replace(key, t0_us=2_000_000)] for key in wanted]

    with SampleArrays(many, load, tiny_config, tmp_path / "samples") as samples:
        samples.open([[100, 1], [50]])
        first = samples.having([100, 1])
        assert set(asked) == {key for key in many if key.clip_id in ("clip11", "clip00")}
        assert isinstance(first.images, np.memmap) and isinstance(first.future, np.memmap)
        samples.having([50, 100])
        assert {key.clip_id for key in asked} == {"clip11", "clip00", "clip05"}
        whole = samples.having(range(len(many))).take([100, 50])
        assert len(asked) == len(set(asked)) == len(many)
    with SampleArrays(many, load, tiny_config, tmp_path / "samples") as samples:
        samples.open([[3]])
        again = samples.having(range(len(many))).take([100, 50])
    assert len(asked) == len(many)
    for name in ("images", "history", "future", "truth_route"):
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))
    expected = DrivingSamples.gather([drives[keys[11]], drives[keys[5]]], tiny_config)
    np.testing.assert_array_equal(whole.images, expected.images)
    with SampleArrays(many[:5], load, tiny_config, tmp_path / "samples") as samples:
        samples.open([])
    assert len(asked) == len(many) + 5


def test_one_sample_and_a_batch_larger_than_the_data(drives, tiny_config, tmp_path):
    key = sorted(drives)[3]
    for name, size in (("one", 1), ("large", 64)):
        stage = STAGE_1.model_copy(update={"per_device_train_batch_size": size, "gradient_accumulation_steps": 3})
        result = train_one(stage, drives, tmp_path / name, tiny_config, [[key]])
        assert result.samples == 1 and np.isfinite(result.losses).all()


def test_images_that_are_all_black_or_wholly_invented_train(drives, tiny_config, tmp_path):
    key = sorted(drives)[0]
    shape = drives[key].image_frames.shape
    black = replace(
        drives[key],
        image_frames=np.zeros(shape, np.uint8),
        image_origin=np.zeros((*shape[:2], *shape[-2:]), np.uint8),
    )
    stage = STAGE_1.model_copy(update={"invented_pixel_weight": 0.0})
    assert train_one(stage, {key: black}, tmp_path / "none", tiny_config, [[key]]).losses == [0.0]
    assert train_one(STAGE_1, {key: black}, tmp_path / "all", tiny_config, [[key]]).losses[0] > 0.0


def test_a_loss_that_is_not_finite_ends_the_training_and_leaves_its_batch(drives, tiny_config, tmp_path):
    keys = sorted(drives)
    stage = STAGE_1.model_copy(update={"save_steps": 1, "learning_rate": 1e30})
    with pytest.raises(InputError, match=r"step 2 .*checkpoint-1 is kept") as caught:
        train_one(stage, drives, tmp_path / "out", tiny_config, [keys[:4], keys[4:8], keys[8:]])
    folder = tmp_path / "out/not-finite-step-2"
    assert str(folder) in str(caught.value)
    about = json.loads((folder / "step.json").read_text())
    assert [sample["clip_id"] for sample in about["samples"]] == [key.clip_id for key in keys[4:8]]
    assert all(about["finite"].values()) and "nan" in about["why"]
    saved = load_file(folder / "samples.safetensors")["future"][1]
    np.testing.assert_allclose(saved[:, :2], drives[keys[5]].ego_future_xyz[0, :, :2], atol=1e-6)
    assert [path.name for path in (tmp_path / "out").glob("checkpoint-*")] == ["checkpoint-1"]
    status = read_statuses(tmp_path / "out")[0]
    assert (status.phase, status.step, status.is_alive()) == ("stopped", 1, False) and "step 2" in status.describe()


@pytest.mark.parametrize("field", ["ego_future_xyz", "ego_history_xyz"])
def test_a_sample_that_is_not_finite_is_refused(drives, tiny_config, tmp_path, field):
    keys = sorted(drives)
    broken = np.array(getattr(drives[keys[5]], field))
    broken[0, 3] = np.nan
    bad = {**drives, keys[5]: replace(drives[keys[5]], **{field: broken})}
    with pytest.raises(InputError, match="clip05 at 2000000 us"):
        train_one(STAGE_1, bad, tmp_path / "out", tiny_config, [keys])
    assert not (tmp_path / "out/samples").exists()


def test_status_of_a_finished_training(trained, capsys):
    _, out = trained
    first, second = read_statuses(out)
    assert (first.stage, first.phase, first.step, first.steps) == (1, "finished", 3, 3)
    assert second.loss is not None and second.best is None and second.is_alive() is False
    assert run(["sft", "status", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["stages"]
    assert [stage["step"] for stage in told] == [3, 3] and not told[0]["alive"]
    assert run(["sft", "status", str(out / "stage2")]) == 0
    assert "finished" in capsys.readouterr().out


def test_status_tells_the_living_from_the_dead(tmp_path):
    write_status(tmp_path, StageStatus(1, "training", 5, 10))
    mine = read_statuses(tmp_path)[0]
    assert mine.is_alive() and str(os.getpid()) in mine.describe()
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    assert replace(mine, process=ended.pid).is_alive() is False
    assert "dead" in replace(mine, process=ended.pid).describe()
    later = replace(mine, process_start="1")  # another process has its number now
    assert later.is_alive() is False
    elsewhere = replace(mine, host=f"not {socket.gethostname()}")
    assert elsewhere.is_alive() is None and "not known" in elsewhere.describe()


def test_status_of_nothing_is_refused(tmp_path):
    with pytest.raises(InputError, match="no training was begun"):
        read_statuses(tmp_path)
    (tmp_path / "status.json").write_text("{}")
    with pytest.raises(InputError, match="by this release"):
        read_statuses(tmp_path)


HOLD_LOCK = (
    "import fcntl, sys; f = open('.lock', 'w'); fcntl.lockf(f, fcntl.LOCK_EX); print(flush=True); sys.stdin.read()"
)


def test_a_second_training_in_the_same_folder_is_refused_and_changes_nothing(copied, drives, tiny_config):
    """Whatever stage the first is in, and before the second removes what it would train anew."""
    before = sorted(copied.rglob("*"))
    with subprocess.Popen(
        [sys.executable, "-c", HOLD_LOCK], cwd=copied, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None and other.stdout.readline()
        with pytest.raises(InputError, match="another process is training here"):
            train_both(drives, tiny_config, copied, STAGE_1.model_copy(update={"seed": 5}))
        other.communicate()
    assert sorted(copied.rglob("*")) == before and read_statuses(copied)[0].phase == "finished"


def test_stage_2_alone_needs_a_finished_stage_1(drives, tiny_config, tmp_path):
    with pytest.raises(InputError, match="train stage 1 there first"):
        train_two_stages(
            (STAGE_1, STAGE_2), lambda *_: [sorted(drives)], lambda keys: [drives[key] for key in keys],
            tmp_path, tiny_config, only="2",
        )  # fmt: skip


def test_stages_one_by_one_are_both_together(trained, drives, tiny_config, tmp_path):
    results = [
        *train_both(drives, tiny_config, tmp_path, only="1"),
        *train_both(drives, tiny_config, tmp_path, only="2"),
    ]
    assert [result.losses for result in results] == [result.losses for result in trained[0]]


def test_the_best_by_driving_goes_on(drives, tiny_config, tmp_path, monkeypatch, trained):
    """The suite decides before open-loop errors do; a suite on which nothing could be scored is the worst."""
    scores = iter([None, 0.4, 0.9, 0.7])

    def drive(checkpoint, stage, validation):
        assert list(validation.scenes) == ["nominal:1"]
        score = next(scores)
        return {
            "alpasim_score": score,
            "collision_rate": score,
            "rollouts": 1,
            "valid": int(score is not None),
            "failed": 0,
        }

    monkeypatch.setattr(judging, "_drive", drive)
    keys = sorted(drives)
    stage = STAGE_2.model_copy(update={"num_train_epochs": 4, "eval_steps": 1, "save_total_limit": 1})
    result = train_stage(
        stage,
        lambda *_: [keys[:4]],
        lambda asked: [drives[key] for key in asked],
        trained[1] / "stage1/checkpoint-3",
        tmp_path / "out",
        validation=Validation([drives[keys[5]]], ["nominal:1"]),
    )
    assert [evaluation["step"] for evaluation in result.evaluations] == [1, 2, 3, 4]
    assert result.checkpoint == "checkpoint-3"
    assert {path.name for path in (tmp_path / "out").glob("checkpoint-*")} == {"checkpoint-3", "checkpoint-4"}
    assert all(evaluation["eval_loss"] > 0.0 for evaluation in result.evaluations)
    assert (tmp_path / "out/curves.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_suite_is_driven(drives, trained, tmp_path):
    keys = sorted(drives)
    result = train_stage(
        STAGE_2,
        lambda *_: [keys[:4]],
        lambda asked: [drives[key] for key in asked],
        trained[1] / "stage1/checkpoint-3",
        tmp_path / "out",
        validation=Validation((), ["nominal:1"], duration_us=2_500_000),
    )
    driven = result.evaluations[0]["closed_loop"]
    assert (driven["rollouts"], driven["valid"]) == (1, 1) and 0.0 <= driven["alpasim_score"] <= 1.0
    assert result.evaluations[0]["open_loop"] is None
