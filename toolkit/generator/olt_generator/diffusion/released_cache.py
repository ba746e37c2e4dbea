"""Training clips in the layout of the released generator's cache (docs/formats/generator.md, Training caches).

Its files are torch archives. They are read by torch's reader that builds tensors, numbers, texts, lists and mappings
and runs no code; a file that needs more is refused.
"""

import pickle
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from olt_generator.cameras import PinholeCamera
from olt_generator.diffusion.config import CELL_PIXELS
from olt_generator.diffusion.geometry_encoder import ego_motion_features
from olt_generator.diffusion.splits import Split
from olt_generator.diffusion.training_clips import TrainingClip
from olt_generator.diffusion.view_graph import VIEWS
from olt_generator.errors import InputError
from olt_generator.poses import invert
from olt_generator.views.plucker import plucker_rays


class ReleasedCache:
    """A folder of released clips, all of them to train on: they come without videos that a view could be scored by.

    Raises:
        InputError: there is none.
    """

    def __init__(self, folder: Path) -> None:
        self._files = _find_clips(folder)
        if not self._files:
            raise InputError(f"{folder}: holds no clip_NNNNNN.pt; give a released cache")
        self._read = lru_cache(maxsize=64)(read_released_clip)

    def numbers(self, split: Split) -> list[int]:
        """The clips of a split."""
        return list(range(len(self._files))) if split == "train" else []

    def clip(self, number: int) -> TrainingClip:
        """See `read_released_clip`; clips of another size than the first are refused."""
        clip, first = self._read(self._files[number]), self._read(self._files[0])
        if clip.latents.shape != first.latents.shape:
            raise InputError(
                f"{self._files[number]}: z_all is {tuple(clip.latents.shape)}, and {tuple(first.latents.shape)} in "
                f"{self._files[0].name}; give clips of one size"
            )
        return clip


def is_released_cache(folder: Path) -> bool:
    """Whether a folder holds clips in the released layout."""
    return bool(_find_clips(folder))


def _find_clips(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("clip_*.pt") if path.stem.removeprefix("clip_").isdigit())


def read_released_clip(path: Path) -> TrainingClip:
    """A clip of a released cache: `clip_NNNNNN.pt`, with `_p4` (poses), `_warp` and, if it is there, `_lookback`.

    As in the released generator, a cell of a rear view takes the lookback warp where that sees more of it.

    Args:
        path: of `clip_NNNNNN.pt`; the others lie beside it.

    Raises:
        InputError: a file is missing, needs code to be read, or lacks a field of the right shape.
    """
    clip, poses, warp = (_read(_beside(path, part)) for part in ("", "_p4", "_warp"))
    latents = _tensor(clip, "z_all", path, (len(VIEWS), 16, None, None, None))
    frames, rows, columns = latents.shape[2:]
    size = (len(VIEWS) - 1, None, frames, rows, columns)
    warped = _tensor(warp, "warped_target_latents", path, size)
    visibility = _tensor(warp, "warped_target_visibility", path, size)
    if _beside(path, "_lookback").exists():
        lookback = _read(_beside(path, "_lookback"))
        earlier = _tensor(lookback, "adjacent_warped_target_latents", path, size)
        seen = _tensor(lookback, "adjacent_warped_target_visibility", path, size)
        warped = torch.where(seen > visibility, earlier, warped)
        visibility = torch.maximum(visibility, seen)
    T_anchor_front = _tensor(poses, "T_anchor_front", path, (frames, 4, 4)).double().numpy()
    matrices = _tensor(clip, "K", path, (len(VIEWS), 3, 3)).double().numpy()
    mountings = _tensor(clip, "E", path, (len(VIEWS), 4, 4)).double().numpy()
    width, height = CELL_PIXELS * columns, CELL_PIXELS * rows
    rays = []
    for K, T_rig_camera in zip(matrices, mountings, strict=True):
        camera = PinholeCamera(width, height, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
        rays.append(plucker_rays(camera, T_anchor_front @ invert(mountings[0]) @ T_rig_camera))
    return TrainingClip(
        latents,
        torch.cat([torch.zeros_like(warped[:1]), warped]),
        torch.cat([torch.zeros_like(visibility[:1]), visibility]),
        torch.from_numpy(np.stack(rays)),
        torch.from_numpy(ego_motion_features(T_anchor_front)),
    )


def _beside(path: Path, part: str) -> Path:
    return path.with_name(f"{path.stem}{part}{path.suffix}")


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(f"{path}: no such file; a released clip has clip, _p4 and _warp beside one another")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError, OSError) as error:
        raise InputError(f"{path}: cannot be read without running code in it; save it as plain tensors") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no mapping; give a file of the released cache")
    return content


def _tensor(content: dict[str, Any], name: str, path: Path, shape: tuple[int | None, ...]) -> Tensor:
    """A field in single precision, of a shape of which None stands for any length."""
    value = content.get(name)
    if not isinstance(value, Tensor):
        raise InputError(f"{path}: {name} is missing; give a file of the released cache")
    same = len(value.shape) == len(shape) and all(b in (None, a) for a, b in zip(value.shape, shape, strict=True))
    if not same:
        raise InputError(f"{path}: {name} is {tuple(value.shape)}, not {shape}")
    if not torch.isfinite(value).all():
        raise InputError(f"{path}: {name} is not finite everywhere")
    return value.float()
