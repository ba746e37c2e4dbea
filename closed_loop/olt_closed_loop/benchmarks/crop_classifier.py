"""A small convolutional network that learns from crops what they show."""

import time
from collections import Counter
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from olt_closed_loop.benchmarks.crops import CROP, KINDS
from olt_closed_loop.sensors.textures import Image
from olt_generator.poses import Array

_EPOCHS, _BATCH = 14, 64
_NEAR = 15.0


def classify(crops: Image, kinds: NDArray[np.int64], distances: Array, seed: int) -> dict[str, Any]:
    """Learn from the first three quarters of the crops (n, 32, 32, 3) and be asked on the others.

    Returns:
        accuracy on all and on those within 15 m, and by kind how many are right and what the others are taken for.
    """
    started = time.perf_counter()
    torch.manual_seed(seed)
    images = torch.from_numpy(crops).permute(0, 3, 1, 2).float() / 128.0 - 1.0
    labels, cut = torch.from_numpy(kinds), 3 * len(kinds) // 4
    network = _train(images[:cut], labels[:cut])
    with torch.no_grad():
        answers = network(images[cut:]).argmax(dim=1).numpy()
    truth, near = kinds[cut:], distances[cut:] < _NEAR
    right = answers == truth
    by_kind = {}
    for number, kind in enumerate(KINDS):
        own = truth == number
        wrong = Counter(answers[own & ~right].tolist()).most_common(1)
        taken_for = f"{KINDS[wrong[0][0]]} ({wrong[0][1]})" if wrong else "nothing"
        by_kind[kind] = {"n": int(own.sum()), "right": float(right[own].mean()), "taken_for": taken_for}
    return {
        "accuracy": float(right.mean()),
        "accuracy_near": float(right[near].mean()),
        "trained": cut,
        "tested": len(truth),
        "seconds": time.perf_counter() - started,
        "by_kind": by_kind,
    }


def _train(images: torch.Tensor, labels: torch.Tensor) -> nn.Module:
    side = CROP // 8
    network = nn.Sequential(
        *_stage(3, 24),
        *_stage(24, 48),
        *_stage(48, 64),
        nn.Flatten(),
        nn.Dropout(0.3),
        nn.Linear(64 * side * side, 128),
        nn.ReLU(),
        nn.Linear(128, len(KINDS)),
    )
    steps = _EPOCHS * -(-len(images) // _BATCH)
    optimizer = torch.optim.AdamW(network.parameters(), lr=2e-3, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 4e-3, total_steps=steps)
    for _ in range(_EPOCHS):
        for batch in torch.randperm(len(images)).split(_BATCH):
            # Seen in a mirror it is of the same kind.
            shown = torch.where(torch.rand(len(batch), 1, 1, 1) < 0.5, images[batch], images[batch].flip(-1))
            loss = nn.functional.cross_entropy(network(shown), labels[batch])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    return network.eval()


def _stage(inputs: int, outputs: int) -> tuple[nn.Module, ...]:
    return nn.Conv2d(inputs, outputs, 3, padding=1), nn.BatchNorm2d(outputs), nn.ReLU(), nn.MaxPool2d(2)
