"""Trains the toy engine in a folder; a process of its own that tests kill, or start twice side by side."""

import sys
from dataclasses import replace
from pathlib import Path

import torch

from olt_generator.diffusion.conditioned_model import build_model
from olt_generator.diffusion.training_cache import TrainingCache
from olt_generator.diffusion.training_loop import train

sys.path.insert(0, str(Path(__file__).parent))
import toy_cache


def main() -> None:
    torch.set_num_threads(1)
    run, steps = Path(sys.argv[1]), int(sys.argv[2])
    flow = toy_cache.make_flow(TrainingCache(run.parent / "cache"))
    model = build_model(toy_cache.ENGINE, seed=1)
    model.backbone.requires_grad_(True)
    train(model, flow.losses, replace(toy_cache.OPTIMIZER, steps=steps), run)


if __name__ == "__main__":
    main()
