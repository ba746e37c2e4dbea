"""One training run of the learned engine: drives to clips, clips to latents, latents to an engine.

Every stage is kept in the run's folder, and a run that was killed goes on where it was. Of many processes the first
makes clips and latents, and the others read them.
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from olt_generator.diffusion.autoencoder_training import train_autoencoder
from olt_generator.diffusion.backbone import load_autoencoder, load_backbone, read_config
from olt_generator.diffusion.conditioned_model import ConditionedModel, build_model, cast
from olt_generator.diffusion.config import CELL_PIXELS, EngineConfig
from olt_generator.diffusion.engine_folder import EngineFacts, save_engine
from olt_generator.diffusion.flow_training import ClipSource, FlowTraining
from olt_generator.diffusion.latents import LatentCodec
from olt_generator.diffusion.released_cache import ReleasedCache
from olt_generator.diffusion.splits import Split
from olt_generator.diffusion.training_cache import CacheFacts, TrainingCache, write_cache
from olt_generator.diffusion.training_clips import ClipVideos, encode_clip, warp_videos
from olt_generator.diffusion.training_loop import train
from olt_generator.diffusion.training_settings import TrainingSettings
from olt_generator.errors import InputError
from olt_generator.progress import Progress
from olt_generator.seeds import derive_seed
from olt_toolkit.clips.training_data import TrainingWindow, frame_time, make_window_videos, plan_windows
from olt_toolkit.clips.training_videos import keep_videos, read_videos
from olt_toolkit.recordings.drives import Dataset, DatasetPlace

VIDEOS, AUTOENCODER, CACHE, ENGINE = "videos", "autoencoder", "cache", "engine"
_TEXT_TOKENS = 4

# Yields what to tell the share that is done of a stage, by its name.
Stages = Callable[[str], AbstractContextManager[Progress]]


@dataclass(frozen=True)
class Weights:
    """What an engine that owns no backbone is trained on: the folder of Wan2.1-VACE, and embeddings of texts."""

    backbone: Path
    text: Path


@dataclass(frozen=True)
class _Networks:
    """What is trained, the autoencoder beside it, and embeddings (l, text_dim) of the prompt and of none."""

    facts: EngineFacts
    model: ConditionedModel
    autoencoder: Any
    prompt: Tensor
    empty: Tensor


def train_engine(
    place: DatasetPlace,
    config: EngineConfig,
    settings: TrainingSettings,
    run: Path,
    seed: int,
    stages: Stages,
    weights: Weights | None = None,
    workers: int = 1,
) -> Path:
    """Train an engine on all drives of a data set, or go on; returns its folder.

    Args:
        workers: processes that make videos of drives where they are kept; the videos are the same for any number.

    Raises:
        InputError: weights are missing or needless, drives cannot be trained on, or see `training_loop.train`.
    """
    if settings.whole_backbone and weights is not None:
        raise InputError("this configuration trains its own backbone; leave the weights out")
    dataset = place.open()
    windows = plan_windows(dataset, settings, seed)
    facts = EngineFacts(config, settings.width, settings.height, frame_time(dataset, windows))
    if settings.whole_backbone:
        with _first_process(), stages("drives") as on_progress:
            keep_videos(place, windows, settings, run / VIDEOS, workers, on_progress)
        networks = _build_networks(windows, facts, settings, run, seed, stages)
    else:
        networks = _load_networks(facts, settings, weights)
    made_by = _digest(networks.autoencoder, config.conditioning.fill)
    with _first_process(), stages("latents") as on_progress:
        codec = LatentCodec(networks.autoencoder)
        cache = _make_cache(dataset, windows, networks.facts, settings, run, codec, made_by, on_progress)
    return _train_model(cache, made_by, networks, settings, run, seed, stages)


def train_on_released(
    cache: ReleasedCache,
    config: EngineConfig,
    settings: TrainingSettings,
    run: Path,
    seed: int,
    stages: Stages,
    weights: Weights | None,
) -> Path:
    """Train an engine on latents in the released layout, or go on; returns its folder.

    Raises:
        InputError: weights are missing, the configuration makes its own latents, or see `training_loop.train`.
    """
    if settings.whole_backbone:
        raise InputError(
            "a released cache holds latents of Wan's autoencoder; give --config 1.3B or a file based on it"
        )
    rows, columns = cache.clip(0).latents.shape[-2:]
    networks = _load_networks(EngineFacts(config, CELL_PIXELS * columns, CELL_PIXELS * rows), settings, weights)
    told = f"{len(cache.numbers('train'))} released clips"
    return _train_model(cache, told, networks, settings, run, seed, stages)


def _train_model(
    cache: ClipSource,
    made_by: str,
    networks: _Networks,
    settings: TrainingSettings,
    run: Path,
    seed: int,
    stages: Stages,
) -> Path:
    facts, model = networks.facts, networks.model
    flow = FlowTraining(cache, settings.flow, seed, networks.prompt, networks.empty)
    with stages("model") as on_progress:
        told = {"engine": asdict(facts.config), "flow": asdict(settings.flow), "seed": seed, "cache": made_by}
        train(model, flow.losses, settings.optimizer, run, settings.precision, told, on_progress)
    with _first_process() as is_first:
        if is_first:
            save_engine(run / ENGINE, facts, model, networks.autoencoder, networks.prompt, networks.empty)
    return run / ENGINE


def _load_networks(facts: EngineFacts, settings: TrainingSettings, weights: Weights | None) -> _Networks:
    """Wan's networks, of which adapters and new modules are trained."""
    if weights is None:
        raise InputError(
            "this configuration needs --backbone, the folder of Wan2.1-VACE, and --text, a safetensors file with the "
            "UMT5 embeddings (tokens, text_dim) `prompt` of the prompt and `empty` of no text (`olt generate embed`)"
        )
    half = torch.bfloat16 if settings.precision == "bfloat16" else torch.float32
    backbone = load_backbone(weights.backbone, dtype=half)
    facts = replace(facts, config=replace(facts.config, backbone=read_config(backbone)))
    model = ConditionedModel(backbone, facts.config)
    cast(model, half)
    model.gradient_checkpointing = True
    texts = _read_texts(weights.text, facts.config.backbone.text_dim)
    return _Networks(facts, model, load_autoencoder(weights.backbone), *texts)


def tiny_texts(width: int) -> tuple[Tensor, Tensor]:
    """Embeddings (l, width) that stand for the prompt and for none, where no text encoder is there."""
    generator = torch.Generator().manual_seed(derive_seed("prompt"))
    return torch.randn(_TEXT_TOKENS, width, generator=generator), torch.zeros(_TEXT_TOKENS, width)


def _build_networks(
    windows: Sequence[TrainingWindow],
    facts: EngineFacts,
    settings: TrainingSettings,
    run: Path,
    seed: int,
    stages: Stages,
) -> _Networks:
    """A model with random weights, all of which are trained, beside an autoencoder that is trained first."""
    kept = [read_videos(run / VIDEOS, number) for number, each in enumerate(windows) if each.split == "train"]
    config = facts.config
    with stages("autoencoder") as on_progress:
        autoencoder, measured = train_autoencoder(
            _to_encode(kept, config.conditioning.fill),
            config.autoencoder,
            settings.autoencoder,
            run / AUTOENCODER,
            seed,
            on_progress,
        )
    facts = replace(facts, config=replace(config, autoencoder=measured), owns_backbone=True)
    with torch.random.fork_rng():
        model = build_model(facts.config, derive_seed("model", seed) % 2**63)
    model.backbone.requires_grad_(True)
    return _Networks(facts, model, autoencoder, *tiny_texts(config.backbone.text_dim))


def _to_encode(clips: Sequence[ClipVideos], fill: bool) -> NDArray[np.uint8]:
    """Videos (n, f, h, w, 3) of all that is encoded: true views, and warped ones."""
    warps = [image for clip in clips for image, _ in warp_videos(clip, fill)]
    return np.concatenate([*(clip.truth for clip in clips), np.stack(warps)])


def _make_cache(
    dataset: Dataset,
    windows: Sequence[TrainingWindow],
    facts: EngineFacts,
    settings: TrainingSettings,
    run: Path,
    codec: LatentCodec,
    made_by: str,
    on_progress: Progress,
) -> TrainingCache:
    assert facts.frame_us is not None
    wanted = CacheFacts(settings.width, settings.height, settings.frames, facts.frame_us, made_by)
    if (run / CACHE).is_dir():
        cache = TrainingCache(run / CACHE)
        if cache.facts != wanted or cache.windows != [each.window for each in windows]:
            raise InputError(f"{run / CACHE}: was made of other drives or by another autoencoder; give another folder")
        return cache
    if (run / VIDEOS).is_dir():
        videos: Iterator[ClipVideos] = (read_videos(run / VIDEOS, number) for number in range(len(windows)))
    else:
        videos = make_window_videos(dataset, windows, settings)

    def encoded() -> Iterator[Any]:
        for done, clip in enumerate(videos):
            yield encode_clip(clip, codec, facts.config.conditioning.fill), clip
            on_progress((done + 1) / len(windows))

    splits: list[Split] = [each.split for each in windows]
    return write_cache(run / CACHE, wanted, [each.window for each in windows], splits, encoded())


def _read_texts(path: Path, width: int) -> tuple[Tensor, Tensor]:
    from olt_generator.metrics.weight_files import read_weights

    texts = read_weights(path)
    for name in ("prompt", "empty"):
        if texts[name].ndim != 2 or texts[name].shape[1] != width:
            raise InputError(f"{path}: {name} is {tuple(texts[name].shape)}; give (tokens, {width})")
    return texts["prompt"], texts["empty"]


def _digest(autoencoder: Any, fill: bool) -> str:
    """A digest of the weights of an autoencoder, and of what it encodes."""
    digest = hashlib.blake2b(b"fill" if fill else b"", digest_size=8)
    for name, parameter in sorted(autoencoder.named_parameters()):
        digest.update(name.encode() + parameter.detach().float().cpu().numpy().tobytes())
    return digest.hexdigest()


@contextmanager
def _first_process() -> Iterator[bool]:
    """Lets the first process go ahead and the others wait for it; tells whether this is the first."""
    from accelerate import PartialState

    state = PartialState(cpu=not torch.cuda.is_available())
    with state.main_process_first():
        yield state.is_main_process
