"""What the weight of invented pixels does: the toy trained on synthesized drives, judged on filmed ones."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from olt_closed_loop import generate_scene
from olt_closed_loop.sensors.recorder import record_drive
from olt_generator.poses import Array
from olt_generator.seeds import make_generator
from olt_sft_recipes.open_loop import evaluate_open_loop, spread_keys
from olt_sft_recipes.toy.policy import load_toy
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.two_stages import train_two_stages
from olt_toolkit import BuildOptions, ClipStore, PolicySample, SampleKey, build_clip
from olt_toolkit.bench.benchmark import Benchmark, Setting
from olt_toolkit.clips.clip import Split
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT
from olt_toolkit.rigs.rig import FRONT_WIDE

FRONT_SIZE, VIEW_SIZE = (256, 144), (112, 64)
FRAME_RATE = 10.0
# Category, seed, whether all cameras film (else the other views are synthesized from the front), and the split.
DRIVES: tuple[tuple[str, int, bool, Split], ...] = (
    *(("nominal", seed, True, "train") for seed in (600, 601)),
    *((category, 610, False, "train") for category in ("nominal", "work_zone", "uncommon_vehicle", "cyclists")),
    *((category, 620, True, "val") for category in ("nominal", "work_zone", "uncommon_vehicle", "cyclists")),
)
SAMPLES_PER_DRIVE, PLANS, EPOCHS = 24, 6, 8
WEIGHTS = (1.0, 0.5, 0.0)
SEEDS = (0, 1, 2)

Samples = dict[SampleKey, PolicySample]


@lru_cache(maxsize=1)
def film() -> tuple[Samples, list[PolicySample]]:
    """Samples to train on, with where their pixels come from, and filmed ones of other drives to judge by."""
    with tempfile.TemporaryDirectory() as folder:
        store = ClipStore(Path(folder))
        for category, seed, filmed, split in DRIVES:
            scene, size = generate_scene(category, seed), VIEW_SIZE if filmed else FRONT_SIZE
            cameras = DEFAULT_CONTRACT.cameras if filmed else (FRONT_WIDE,)
            recording = record_drive(scene, *size, FRAME_RATE, cameras)
            options = BuildOptions(*VIEW_SIZE, use_reference_views=filmed, image_kind="rendered", split=split)
            store.commit([store.prepare(build_clip(recording, options).clip).clip_id])
        trained = spread_keys(store, "train", SAMPLES_PER_DRIVE)
        held_out = spread_keys(store, "val", SAMPLES_PER_DRIVE // 4)
        samples = store.load_samples(trained, contract=DEFAULT_CONTRACT, with_origin=True)
        return dict(zip(trained, samples, strict=True)), store.load_samples(held_out, contract=DEFAULT_CONTRACT)


def train(weight: float) -> Array:
    """Open-loop errors (seeds,) in metres of policies trained with this weight, one for each seed."""
    samples, held_out = film()
    keys = sorted(samples)

    def batches(epoch: int, size: int) -> list[Sequence[SampleKey]]:
        order = make_generator("invented pixels", epoch).permutation(len(keys))
        return [[keys[row] for row in order[start : start + size]] for start in range(0, len(keys), size)]

    errors = []
    for seed in SEEDS:
        shared: dict[str, Any] = {
            "num_train_epochs": EPOCHS,
            "per_device_train_batch_size": 8,
            "warmup_steps": 10,
            "seed": seed,
        }
        shared |= {"mirror_probability": 0.5, "invented_pixel_weight": weight}
        stages = (
            StageConfig(stage=1, learning_rate=1e-3, regression_warmup_epochs=EPOCHS - 2, **shared),
            StageConfig(stage=2, learning_rate=2e-3, **shared),
        )
        with tempfile.TemporaryDirectory() as out:
            train_two_stages(stages, batches, lambda wanted: [samples[key] for key in wanted], Path(out))
            policy = load_toy(str(Path(out) / "policy"))
        errors.append(evaluate_open_loop(policy, held_out, PLANS)["min_ade"])
    return np.array(errors)


def _settings() -> Sequence[Setting]:
    def prepare(weight: float) -> Callable[[], Array]:
        film()
        return partial(train, weight)

    return [Setting(f"weight {weight}", partial(prepare, weight), weight == 1.0) for weight in WEIGHTS]


def _figures(errors: Array) -> Mapping[str, float]:
    return {"smallest of the seeds (m)": float(errors.min()), "largest of the seeds (m)": float(errors.max())}


BENCHMARK = Benchmark(
    title="Toy policy trained on synthesized drives, by the weight of an invented pixel in the loss",
    error_name="minADE of 6 plans, mean over 3 training seeds",
    error_unit="m",
    reference="futures that were driven, of filmed drives that no policy was trained on",
    settings=_settings,
    measure_error=lambda errors: float(np.mean(errors)),
    figures=_figures,
)
