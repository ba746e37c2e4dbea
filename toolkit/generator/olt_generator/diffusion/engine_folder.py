"""A trained engine as a folder: what it is, its weights, and its prompt (docs/formats/generator.md).

An engine either owns its backbone and autoencoder, as the tiny one does, or was trained beside weights of Wan, which
stay in their own folder.
"""

import hashlib
import json
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from olt_generator.diffusion.backbone import build_autoencoder, load_autoencoder, load_backbone, read_config
from olt_generator.diffusion.conditioned_model import ConditionedModel, build_model, cast
from olt_generator.diffusion.config import (
    AutoencoderConfig,
    BackboneConfig,
    ConditioningConfig,
    EngineConfig,
    LoraConfig,
)
from olt_generator.diffusion.latents import LatentCodec
from olt_generator.diffusion.tensor_files import read_tensors
from olt_generator.diffusion.warp_control import Layout
from olt_generator.errors import InputError
from olt_generator.files import read_bounded, write_whole_folder
from olt_generator.views.plucker import TOKEN_PIXELS

if TYPE_CHECKING:
    from diffusers.models.autoencoders.autoencoder_kl_wan import AutoencoderKLWan

FORMAT = 1
FACTS, MODEL, AUTOENCODER, TEXT = "engine.json", "model.safetensors", "autoencoder.safetensors", "text.safetensors"
_MOST_BYTES = 1_000_000
_PARTS = {
    "backbone": BackboneConfig,
    "autoencoder": AutoencoderConfig,
    "conditioning": ConditioningConfig,
    "lora": LoraConfig,
}


@dataclass(frozen=True)
class EngineFacts:
    """What must be known of an engine to use it as it was trained.

    Attributes:
        config: sizes of the networks.
        width, height: of the straight-lined images (`rectified`), multiples of 16.
        frame_us: time between frames of the training videos; None where it is not known.
        layout: how the warp stands in the control.
        owns_backbone: whether backbone and autoencoder are in the folder.

    Raises:
        InputError: the images do not fill tokens, or the layout is unknown.
    """

    config: EngineConfig
    width: int
    height: int
    frame_us: int | None = None
    layout: Layout = "released"
    owns_backbone: bool = False

    def __post_init__(self) -> None:
        if min(self.width, self.height) < TOKEN_PIXELS or self.width % TOKEN_PIXELS or self.height % TOKEN_PIXELS:
            raise InputError(f"engine images of {self.width} x {self.height}: give multiples of {TOKEN_PIXELS}")
        if self.layout not in get_args(Layout):
            raise InputError(f"layout {self.layout!r}: choose from {', '.join(get_args(Layout))}")


@dataclass(frozen=True)
class Engine:
    """A loaded engine.

    Attributes:
        model, codec: the networks, ready to sample.
        prompt, empty: (1, l, text_dim) embeddings of the prompt of training, and of no prompt.
        digest: of all weights; two engines that generate alike have the same one.
        dtype: precision of the weights.
    """

    facts: EngineFacts
    model: ConditionedModel
    codec: LatentCodec
    prompt: Tensor
    empty: Tensor
    digest: str
    dtype: torch.dtype

    @property
    def device(self) -> torch.device:
        """Where the model runs."""
        return self.prompt.device


def save_engine(
    folder: Path,
    facts: EngineFacts,
    model: ConditionedModel,
    autoencoder: "AutoencoderKLWan",
    prompt: Tensor,
    empty: Tensor,
) -> None:
    """Write an engine; the folder appears whole. Texts are (l, text_dim).

    Raises:
        InputError: the folder cannot be written.
    """
    told = {"format": FORMAT, **asdict(facts)}
    with write_whole_folder(folder) as temporary:
        save_file(_kept(model, facts.owns_backbone), temporary / MODEL)
        if facts.owns_backbone:
            save_file(_plain(dict(autoencoder.named_parameters())), temporary / AUTOENCODER)
        save_file(_plain({"prompt": prompt, "empty": empty}), temporary / TEXT)
        (temporary / FACTS).write_text(json.dumps(told, indent=2, sort_keys=True) + "\n")


def read_facts(folder: Path) -> EngineFacts:
    """What an engine is, without its weights.

    Raises:
        InputError: there is no engine, it is of another format, or a field is wrong.
    """
    path = folder / FACTS
    try:
        told = json.loads(read_bounded(path, "engine", _MOST_BYTES))
    except ValueError as error:
        raise InputError(f"{path}: is no JSON ({error})") from error
    if not isinstance(told, dict) or told.pop("format", None) != FORMAT:
        raise InputError(f"{path}: is no engine of format {FORMAT}; train it with this release")
    config = told.get("config")
    if not isinstance(config, dict) or config.keys() != _PARTS.keys():
        raise InputError(f"{path}: config: give {', '.join(_PARTS)}")
    parts: dict[str, Any] = {name: _read(kind, config[name], f"{path}: config.{name}") for name, kind in _PARTS.items()}
    return _read(EngineFacts, told | {"config": EngineConfig(**parts)}, str(path))


def load_engine(
    folder: Path, backbone: Path | None = None, device: str = "cpu", dtype: torch.dtype = torch.float32
) -> Engine:
    """Load an engine to sample with.

    Args:
        backbone: folder of Wan2.1-VACE as diffusers writes it, where the engine does not own one.
        dtype: precision of the weights; norms, modulation and gates stay in single precision.

    Raises:
        InputError: files are missing, damaged, or of another engine, or the backbone is given needlessly or not given.
    """
    facts = read_facts(folder)
    if facts.owns_backbone != (backbone is None):
        raise InputError(
            f"{folder}: "
            + ("has its own backbone; leave the other one out" if backbone else "needs the folder of Wan2.1-VACE")
        )
    if backbone is None:
        model, autoencoder = build_model(facts.config), build_autoencoder(facts.config.autoencoder)
        _fill(autoencoder, _load(folder / AUTOENCODER), dict(autoencoder.named_parameters()), folder / AUTOENCODER)
        nn.Module.to(autoencoder, device)
    else:
        loaded = load_backbone(backbone, device, dtype)
        config = EngineConfig(
            read_config(loaded), facts.config.autoencoder, facts.config.conditioning, facts.config.lora
        )
        # The autoencoder stays in single precision: it runs once a view, and its errors would be seen.
        model, autoencoder = ConditionedModel(loaded, config), load_autoencoder(backbone, device)
    _fill(model, _load(folder / MODEL), _kept(model, facts.owns_backbone), folder / MODEL)
    model.requires_grad_(False).eval().to(device)
    cast(model, dtype, trainable=True)
    texts = _load(folder / TEXT)
    if texts.keys() != {"prompt", "empty"} or any(text.ndim != 2 for text in texts.values()):
        raise InputError(f"{folder / TEXT}: holds {', '.join(sorted(texts))}; give prompt and empty, (l, text_dim)")
    prompt, empty = (texts[name][None].to(device) for name in ("prompt", "empty"))
    return Engine(facts, model, LatentCodec(autoencoder), prompt, empty, digest_engine(folder, backbone), dtype)


def digest_engine(folder: Path, backbone: Path | None = None) -> str:
    """A digest of an engine's files; of a backbone, which is large, of the names and sizes of its files."""
    digest = hashlib.blake2b(digest_size=8)
    for name in (FACTS, MODEL, AUTOENCODER, TEXT):
        if (folder / name).is_file():
            state = (folder / name).stat()
            digest.update(_digest_file(folder / name, state.st_size, state.st_mtime_ns))
    if backbone is not None:
        for path in sorted(path for path in backbone.rglob("*") if path.is_file()):
            digest.update(f"{path.relative_to(backbone).as_posix()}:{path.stat().st_size}".encode())
    return digest.hexdigest()


@lru_cache(maxsize=16)  # every clip of a run asks for the digest of its engine
def _digest_file(path: Path, size: int, changed_ns: int) -> bytes:
    """A digest of a file; size and time of change tell whether it is still the same."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "blake2b").digest()


def _kept(model: ConditionedModel, everything: bool) -> dict[str, Tensor]:
    return _plain({name: p for name, p in model.named_parameters() if everything or p.requires_grad})


def _plain(tensors: dict[str, Any]) -> dict[str, Tensor]:
    return {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}


def _load(path: Path) -> dict[str, Tensor]:
    return read_tensors(path, "copy the whole folder of the engine")


def _fill(module: nn.Module, found: dict[str, Tensor], wanted: dict[str, Any], path: Path) -> None:
    """Load exactly the wanted parameters, each in its shape."""
    odd = sorted(wanted.keys() ^ found.keys())
    odd += sorted(name for name in wanted.keys() & found.keys() if wanted[name].shape != found[name].shape)
    if odd:
        raise InputError(f"{path}: {len(odd)} tensors are not those of this engine, such as {odd[0]}")
    module.load_state_dict(found, strict=False)


def _read(kind: Any, values: object, where: str) -> Any:
    """A dataclass of JSON values, in which lists stand for tuples."""
    if not isinstance(values, dict):
        raise InputError(f"{where}: is no object")
    names = {field.name for field in fields(kind)}
    if values.keys() != names:
        raise InputError(f"{where}: {sorted(values.keys() ^ names)[0]} is missing or unknown")
    for field in fields(kind):
        example = getattr(kind, field.name, None)
        if isinstance(example, bool | int) and type(values[field.name]) is not type(example):
            raise InputError(f"{where}.{field.name}: {values[field.name]!r:.40} is no {type(example).__name__}")
    plain = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    try:
        return kind(**plain)
    except (TypeError, AttributeError) as error:
        raise InputError(f"{where}: {error}") from error
