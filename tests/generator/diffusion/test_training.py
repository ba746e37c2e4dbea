"""Training: samples, splits, cache, schedule, gates, resume after a kill, and many processes as one."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.diffusion.conditioned_model import build_model, cast
from olt_generator.diffusion.released_cache import read_released_clip
from olt_generator.diffusion.splits import Window, assign_splits, check_splits
from olt_generator.diffusion.training_cache import TrainingCache
from olt_generator.diffusion.training_loop import make_optimizer, rate_share, train
from olt_generator.diffusion.training_settings import OptimizerSettings
from olt_generator.errors import InputError

from . import toy_cache

SCRIPT = Path(__file__).with_name("train_toy.py")


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return toy_cache.make_cache(tmp_path_factory.mktemp("training") / "cache")


def losses(run):
    return [json.loads(row)["loss"] for row in (run / "losses.jsonl").read_text().splitlines()]


def test_a_sample_is_the_flow_from_data_to_noise(cache):
    flow = toy_cache.make_flow(cache)
    batch = flow.draw(range(5))
    assert batch.conditions.camera.tolist() == [1, 2, 3, 4, 5]
    assert batch.weight.tolist() == [1.0, 1.0, 1.0, 1.0, 0.5]
    assert batch.conditions.views.filled.tolist() == [
        [True, False, False],
        [True, False, False],
        [True, True, False],
        [True, True, False],
        [True, True, True],
    ]
    clean = batch.latents - batch.sigma[:, None, None, None, None] * batch.target
    trained = torch.cat([cache.clip(number).latents for number in cache.numbers("train")])
    for latents in clean:
        assert (trained - latents).abs().flatten(1).amax(dim=1).min() < 1e-5
    torch.testing.assert_close(flow.draw([3]).latents[0], batch.latents[3], rtol=0, atol=0)


def test_text_is_dropped_and_conditions_are_noised_as_often_as_said(cache):
    flow = toy_cache.make_flow(cache, text_drop=0.3, neighbour_noise=(0.5, 0.02, 0.15))
    batch = flow.draw(range(2, 2000, 5))
    dropped = (batch.conditions.text == 0).all(dim=(1, 2)).float().mean()
    assert abs(float(dropped) - 0.3) < 0.08
    known = torch.stack([cache.clip(number).latents for number in cache.numbers("train")])
    front, neighbour = batch.conditions.views.latents[:, 0], batch.conditions.views.latents[:, 1]
    for seen, view, share in ((front, 0, 0.05), (neighbour, 1, 0.5)):
        off = (seen[:, None] - known[None, :, view]).abs().flatten(2).amax(dim=2).amin(dim=1)
        assert abs(float((off > 1e-6).float().mean()) - share) < 0.08


def test_noise_levels_are_shifted(cache):
    sigma = toy_cache.make_flow(cache).draw(range(500)).sigma
    time_of = sigma / (3.0 - 2.0 * sigma)
    assert abs(float(time_of.mean()) - 0.5) < 0.04
    assert float(sigma.mean()) > 0.6


def test_what_a_warp_saw_counts_less_where_said(cache):
    class Wrong(torch.nn.Module):
        """Off by 1 where nothing was seen, and by 3 where everything was."""

        def __init__(self, batch):
            super().__init__()
            self.answer = torch.nn.Parameter(batch.target + 1.0 + 2.0 * batch.visibility)

        def forward(self, latents, sigma, conditions):
            return self.answer

    batch = toy_cache.make_flow(cache).draw(range(5))
    seen = batch.visibility.flatten(1)
    for weight in (1.0, 0.25):
        losses = toy_cache.make_flow(cache, seen_weight=weight).losses(Wrong(batch), list(range(5)))
        counts = 1.0 - (1.0 - weight) * seen
        expected = (counts * (1.0 + 2.0 * seen) ** 2).sum(dim=1) / counts.sum(dim=1)
        torch.testing.assert_close(losses, expected * batch.weight, rtol=1e-4, atol=1e-5)
    with pytest.raises(InputError, match="seen_weight"):
        toy_cache.make_flow(cache, seen_weight=0.0)


def test_cache_is_read_as_it_was_written(cache):
    again = TrainingCache(cache.folder)
    clip, videos = toy_cache.draw_clip(2)
    assert again.numbers("train") == [0, 1]
    torch.testing.assert_close(again.clip(2).latents, clip.latents, rtol=1e-3, atol=1e-3)
    np.testing.assert_array_equal(again.videos(2).truth, videos.truth)
    np.testing.assert_array_equal(again.videos(2).known, videos.known)
    with pytest.raises(InputError, match="only clips for evaluation keep videos"):
        again.videos(0)


@pytest.mark.parametrize(
    ("file", "said"),
    [("cache.json", "training cache"), ("clips.parquet", "Parquet"), ("clip_000000.safetensors", "safe")],
)
def test_a_damaged_cache_is_refused(tmp_path, file, said):
    made = toy_cache.make_cache(tmp_path / "cache")
    (made.folder / file).write_bytes(b"no")
    with pytest.raises(InputError, match=said):
        TrainingCache(made.folder).clip(0)


@settings(max_examples=50, deadline=None)
@given(
    scenes=st.integers(1, 12),
    count=st.integers(1, 6),
    seen=st.floats(0.0, 0.6),
    unseen=st.floats(0.0, 0.6),
    seed=st.integers(0, 99),
)
def test_splits_never_leak(scenes, count, seen, unseen, seed):
    windows = [
        Window("synthetic", str(scene), 10 * part, 10 * part + 8) for scene in range(scenes) for part in range(count)
    ]
    splits = assign_splits(windows, seen, unseen, seed)
    assert "train" in splits
    for scene in {window.scene for window in windows}:
        own = {split for window, split in zip(windows, splits, strict=True) if window.scene == scene}
        assert own in ({"unseen"}, {"train"}, {"train", "seen"})
    assert splits == assign_splits(windows, seen, unseen, seed)


@pytest.mark.parametrize(
    ("windows", "splits", "said"),
    [
        ([("waymo_e2e", "a", 0, 1)], ["train"], "waymo_e2e is for evaluation only"),
        ([("pav", "a", 0, 1), ("pav", "a", 2, 3)], ["train", "unseen"], "both unseen and trained on"),
        ([("pav", "a", 0, 5), ("pav", "a", 5, 9)], ["train", "seen"], "shares images"),
        ([("pav", "a", 0, 9), ("pav", "a", 2, 3), ("pav", "a", 8, 12)], ["train", "train", "seen"], "shares images"),
        ([("pav", "a", 0, 5), ("pav", "b", 0, 5)], ["seen", "train"], "nothing of it is trained on"),
        ([("pav", "a", 0, 5)], ["unseen"], "no window is left"),
    ],
)
def test_splits_that_leak_are_refused(windows, splits, said):
    with pytest.raises(InputError, match=said):
        check_splits([Window(*window) for window in windows], splits)


def test_the_rate_rises_then_falls_to_its_least():
    schedule = OptimizerSettings(steps=2000, warmup=500)
    shares = [rate_share(step, schedule) for step in range(2000)]
    assert shares[0] == pytest.approx(1 / 500) and shares[499] == shares[500] == 1.0
    assert shares[-1] == pytest.approx(0.1)
    assert all(a >= b for a, b in pairwise(shares[500:]))


def test_adapters_have_their_own_group_without_decay():
    model = build_model(toy_cache.ENGINE)
    trained = {name: p for name, p in model.named_parameters() if p.requires_grad}
    groups = make_optimizer(trained, OptimizerSettings()).param_groups
    assert [group["weight_decay"] for group in groups] == [0.0, 0.1]
    assert {id(p) for p in groups[0]["params"]} == {id(p) for n, p in trained.items() if "lora_" in n}
    assert sum(len(group["params"]) for group in groups) == len(trained)


def test_gates_learn_in_half_precision(cache, tmp_path):
    """At the paper's rate of 1e-5 a bfloat16 bias of -1.4 would not move: its neighbour is 0.008 away."""
    model = build_model(toy_cache.ENGINE, seed=1)
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if "to_out" in name and "memory_attention" in name:
                parameter += 0.05
    cast(model, torch.bfloat16)
    before = {name: p.detach().clone() for name, p in model.named_parameters() if "gates" in name}
    quick = replace(toy_cache.OPTIMIZER, steps=3, adapter_rate=1e-5, new_rate=1e-5, warmup=0)
    train(model, toy_cache.make_flow(cache).losses, quick, tmp_path / "run", "bfloat16")
    biases = [name for name in before if name.endswith("mlp.2.bias")]
    now = dict(model.named_parameters())
    assert biases
    for name in biases:
        moved = (now[name] - before[name]).abs()
        assert now[name].dtype == torch.float32
        assert 0.0 < float(moved.max()) < 1e-3
    assert model.backbone.proj_out.weight.dtype == torch.bfloat16


def test_the_running_mean_is_what_the_model_ends_with(cache, tmp_path):
    model = build_model(toy_cache.ENGINE, seed=1)
    means = train(model, toy_cache.make_flow(cache).losses, toy_cache.OPTIMIZER, tmp_path / "run")
    for name, parameter in model.named_parameters():
        if name in means:
            torch.testing.assert_close(parameter.detach(), means[name], rtol=0, atol=0)
    assert sorted(path.name for path in (tmp_path / "run" / "steps").iterdir()) == ["step_000004", "step_000006"]


def test_another_run_is_not_gone_on_with(cache, tmp_path):
    flow = toy_cache.make_flow(cache)
    train(build_model(toy_cache.ENGINE, seed=1), flow.losses, replace(toy_cache.OPTIMIZER, steps=2), tmp_path / "run")
    with pytest.raises(InputError, match="other settings"):
        train(build_model(toy_cache.ENGINE, seed=1), flow.losses, toy_cache.OPTIMIZER, tmp_path / "run")


def start(run, steps, extra=None):
    environment = os.environ | {"OMP_NUM_THREADS": "1"} | (extra or {})
    return subprocess.Popen([sys.executable, str(SCRIPT), str(run), str(steps)], env=environment)


@pytest.mark.slow
def test_a_killed_run_has_the_losses_that_it_would_have_had(tmp_path):
    toy_cache.make_cache(tmp_path / "cache")
    assert start(tmp_path / "whole", 16).wait(900) == 0
    killed = start(tmp_path / "killed", 16)
    log = tmp_path / "killed" / "losses.jsonl"
    while killed.poll() is None and not (log.exists() and log.read_text().count("\n") >= 7):
        time.sleep(0.002)
    killed.send_signal(signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL
    assert len(losses(tmp_path / "killed")) < 16
    assert start(tmp_path / "killed", 16).wait(900) == 0
    assert losses(tmp_path / "killed") == losses(tmp_path / "whole")
    for name in ("model", "average", "optimizer"):
        file = f"steps/step_000016/{name}.safetensors"
        assert (tmp_path / "killed" / file).read_bytes() == (tmp_path / "whole" / file).read_bytes()


@pytest.mark.slow
def test_two_processes_have_the_losses_of_one(tmp_path):
    toy_cache.make_cache(tmp_path / "cache")
    assert start(tmp_path / "one", 6).wait(900) == 0
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    world = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "ACCELERATE_USE_CPU": "true"}
    both = [start(tmp_path / "two", 6, world | {"RANK": str(n), "LOCAL_RANK": str(n)}) for n in range(2)]
    assert [process.wait(900) for process in both] == [0, 0]
    np.testing.assert_allclose(losses(tmp_path / "two"), losses(tmp_path / "one"), rtol=0, atol=1e-5)


def test_a_released_clip_is_read(tmp_path):
    clip = read_released_clip(toy_cache.write_released(tmp_path))
    assert clip.latents.shape == (6, 16, 2, 4, 6) and clip.latents.dtype == torch.float32
    assert clip.rays.shape == (6, 6, 2, 2, 3)
    assert clip.motion[1].tolist() == [0.0, 0.0, 2.0, 0.0, 0.0, 0.0]
    assert not clip.warped[:3].any() and not clip.visibility[:3].any()
    assert (clip.warped[3:, ..., :3] == 1.0).all() and not clip.warped[3:, ..., 3:].any()
    (tmp_path / "clip_000001_lookback.pt").unlink()
    assert not read_released_clip(tmp_path / "clip_000001.pt").visibility.any()


class Code:
    """What pickle would run when it is read."""

    def __reduce__(self):
        return (os.getenv, ("HOME",))


@pytest.mark.parametrize("odd", ["code", "missing", "shape"])
def test_odd_released_clips_are_refused(tmp_path, odd):
    path = toy_cache.write_released(tmp_path)
    content = torch.load(path, weights_only=True)
    if odd == "missing":
        del content["K"]
    changes = {"code": {"note": Code()}, "missing": {}, "shape": {"E": torch.eye(4)}}[odd]
    torch.save(content | changes, path)
    with pytest.raises(InputError, match={"code": "running code", "missing": "K is missing", "shape": "E is"}[odd]):
        read_released_clip(path)
