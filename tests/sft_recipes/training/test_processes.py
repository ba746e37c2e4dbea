"""Several processes train what one does."""

import json
import os
import runpy
import subprocess
import sys
import types
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from accelerate.utils import LoggerType

from olt_generator.errors import InputError
from olt_sft_recipes.training.processes import run_on_processes
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.two_stages import train_stage

SCRIPT = Path(__file__).with_name("trained_by_processes.py")
TORCHRUN = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]


def read_losses(out):
    return json.loads((out / "losses.json").read_text())


@pytest.mark.slow
def test_two_processes_have_the_losses_of_one(tmp_path):
    runpy.run_path(str(SCRIPT))["main"](tmp_path / "one")
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    subprocess.run([*TORCHRUN, SCRIPT, tmp_path / "two"], check=True, timeout=900, env=environment)
    alone, two = read_losses(tmp_path / "one"), read_losses(tmp_path / "two")
    for stage in range(2):
        np.testing.assert_allclose(two[stage], alone[stage], atol=1e-5)
    assert two != alone  # sums in another order: that they are the same to the bit would be suspicious


@pytest.mark.slow
def test_what_fails_on_the_processes_fails(tmp_path):
    with pytest.raises(InputError, match="2 processes"):
        run_on_processes(["sft", "train", "--mixture", str(tmp_path / "none.json"), "--out", str(tmp_path)], 2)


@pytest.mark.parametrize("tracker", ["tensorboard", "wandb"])
def test_an_absent_tracker_is_told_before_anything_is_written(drives, tiny_config, tmp_path, monkeypatch, tracker):
    monkeypatch.setattr("olt_sft_recipes.training.processes._AVAILABLE", {tracker: lambda: False})
    stage = StageConfig(stage=1, num_train_epochs=1, report_to=tracker)
    with pytest.raises(InputError, match=f"pip install {tracker}"):
        train_stage(
            stage, lambda *_: [sorted(drives)], lambda keys: [drives[key] for key in keys], None, tmp_path / "out"
        )
    assert not (tmp_path / "out").exists()


class Recorder:
    """Stands in for TensorBoard's writer."""

    told: ClassVar = []

    def __init__(self, logging_dir, **_):
        self.folder = logging_dir

    def add_hparams(self, *_, **__):
        pass

    def add_scalar(self, name, value, global_step=None, **_):
        self.told.append((name, value, global_step))

    def flush(self):
        pass

    def close(self):
        self.told.append("closed")


def test_a_tracker_is_told_every_loss(drives, tiny_config, tmp_path, monkeypatch):
    for name in ("torch.utils.tensorboard", "tensorboardX"):
        monkeypatch.setitem(sys.modules, name, types.SimpleNamespace(SummaryWriter=Recorder))
    monkeypatch.setattr("torch.utils.tensorboard", sys.modules["tensorboardX"], raising=False)
    monkeypatch.setattr("accelerate.tracking._available_trackers", [LoggerType.TENSORBOARD])
    monkeypatch.setattr("olt_sft_recipes.training.processes._AVAILABLE", {"tensorboard": lambda: True})
    monkeypatch.setattr(Recorder, "told", [])
    stage = StageConfig(stage=1, num_train_epochs=2, report_to="tensorboard", warmup_steps=1)
    result = train_stage(
        stage,
        lambda *_: [sorted(drives)],
        lambda keys: [drives[key] for key in keys],
        None,
        tmp_path / "out",
        tiny_config,
    )
    losses = [
        (value, step) for name, value, step in [told for told in Recorder.told if told != "closed"] if name == "loss"
    ]
    assert losses == [(loss, index + 1) for index, loss in enumerate(result.losses)]
    assert Recorder.told[-1] == "closed"
