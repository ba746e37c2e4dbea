"""One view of one window: noise, conditions and memory to latents (paper, Algorithm 1, the body of its loop)."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from olt_generator.cameras import Camera
from olt_generator.diffusion.conditioned_model import Conditions
from olt_generator.diffusion.config import CELL_PIXELS, LATENT_CHANNELS
from olt_generator.diffusion.engine_folder import Engine
from olt_generator.diffusion.geometry_encoder import ego_motion_features
from olt_generator.diffusion.memory_bank import ConditionViews
from olt_generator.diffusion.sampling import Solver, guided_velocity, integrate, sigma_grid
from olt_generator.diffusion.view_graph import MOST_CONDITIONS
from olt_generator.diffusion.windows import OVERLAP, WINDOW
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_generator.seeds import derive_seed
from olt_generator.views.plucker import anchor_poses, plucker_rays

# Views whose guidance is that of the rear.
REAR_VIEWS = (3, 4, 5)


@dataclass(frozen=True)
class GenerationSettings:
    """How views are sampled; the defaults are the paper's and its released sampler's.

    Attributes:
        steps, solver: of the sampler.
        cross_guidance, rear_guidance: how far the views are led away from what no prompt says; 1 for one pass a step.
        shared_noise: weight of the noise that all views share, 0 to 1.
        window, overlap: frames of a video, 4 k + 1, and of what two of them share, 4 j + 1.
        conditions: views that one is conditioned on at most, 0 to 3; the front view is the first.
        keep_observed: whether pixels that the front camera saw are taken from the warp.
        tile: side of the tiles that are decoded, pixels; None to decode whole images.

    Raises:
        InputError: a value is outside of its range.
    """

    steps: int = 50
    solver: Solver = "euler"
    cross_guidance: float = 3.5
    rear_guidance: float = 7.0
    shared_noise: float = 0.5
    window: int = WINDOW
    overlap: int = OVERLAP
    conditions: int = MOST_CONDITIONS
    keep_observed: bool = True
    tile: int | None = None

    def __post_init__(self) -> None:
        sigma_grid(self.steps)
        if not 0.0 <= self.shared_noise <= 1.0:
            raise InputError(f"shared noise {self.shared_noise}: give a weight from 0 to 1")
        if not 0 <= self.conditions <= MOST_CONDITIONS:
            raise InputError(f"{self.conditions} conditions: give 0 to {MOST_CONDITIONS}")
        if not (np.isfinite(self.cross_guidance) and np.isfinite(self.rear_guidance)):
            raise InputError("guidance: give finite numbers")

    def guidance(self, view: int) -> float:
        """The guidance of a view."""
        return self.rear_guidance if view in REAR_VIEWS else self.cross_guidance


@dataclass(frozen=True)
class WindowGeometry:
    """Where the cameras are at the t latent frames of a window.

    Attributes:
        T_world_front: (t, 4, 4) poses of the front camera.
        T_rig_front: (4, 4) its mounting.
    """

    T_world_front: Array
    T_rig_front: Array

    def rays(self, camera: Camera, T_rig_camera: Array) -> Tensor:
        """Pluecker rays (1, 6, t, h / 16, w / 16) of a camera, in the frame of the first front camera."""
        poses = anchor_poses(self.T_world_front, self.T_rig_front, T_rig_camera)
        return torch.from_numpy(plucker_rays(camera, poses))[None]

    def motion(self) -> Tensor:
        """Features (1, t, 6) of the ego motion."""
        poses = anchor_poses(self.T_world_front, self.T_rig_front, self.T_rig_front)
        return torch.from_numpy(ego_motion_features(poses))[None]


@dataclass(frozen=True)
class MemorizedView:
    """A view that others are conditioned on: its id, latents (1, 16, t, h, w) and rays (1, 6, t, h / 2, w / 2)."""

    view: int
    latents: Tensor
    rays: Tensor


def gather_conditions(
    engine: Engine, view: int, rays: Tensor, motion: Tensor, control: Tensor, memory: Sequence[MemorizedView]
) -> Conditions:
    """All that a view (1 in the batch) is conditioned on, on the engine's device; no memory where it is empty."""
    device = engine.device
    views = None
    if memory:
        views = ConditionViews(
            torch.stack([each.latents for each in memory], dim=1).to(device),
            torch.tensor([[each.view for each in memory]], device=device),
            torch.stack([each.rays for each in memory], dim=1).to(device),
        )
    camera = torch.tensor([view], device=device)
    return Conditions(engine.prompt, camera, rays.to(device), motion.to(device), control.to(device), views)


@torch.inference_mode()
def sample_view(
    engine: Engine, view: int, conditions: Conditions, noise: Tensor, settings: GenerationSettings
) -> Tensor:
    """Latents (1, 16, t, h, w), float32 on the processor, of a view from noise in that shape."""
    velocity = guided_velocity(engine.model, conditions, engine.empty, settings.guidance(view))
    grid = sigma_grid(settings.steps)
    return integrate(velocity, noise.to(engine.device), grid, settings.solver).float().cpu()


def draw_noise(seed: int, view: int, start: int, shape: tuple[int, int, int], shared: float) -> Tensor:
    """Noise (1, 16, t, h, w) of a view: shared a + sqrt(1 - shared^2) b, where all views of the clip have the same a.

    Each latent frame of the clip has its own generator, so that windows which share frames share their noise.

    Args:
        start: latent frame of the clip at which the window starts.
        shape: latent frames, rows and columns of cells.
    """
    frames, height, width = shape
    of_frames = [
        shared * _normal(seed, "all views", start + frame, height, width)
        + (1.0 - shared**2) ** 0.5 * _normal(seed, f"view {view}", start + frame, height, width)
        for frame in range(frames)
    ]
    return torch.stack(of_frames, dim=1)[None]


def digest_inputs(conditions: Conditions, noise: Tensor, *keys: object) -> str:
    """A digest of everything that the latents of a view follow from."""
    digest = hashlib.blake2b(repr(keys).encode(), digest_size=16)
    tensors = [conditions.text, conditions.camera, conditions.rays, conditions.motion, conditions.control, noise]
    if conditions.views is not None:
        tensors += [conditions.views.latents, conditions.views.camera, conditions.views.rays]
    for tensor in tensors:
        digest.update(repr(tuple(tensor.shape)).encode() + _bytes(tensor))
    return digest.hexdigest()


def needed_pixels(looked_at: NDArray[np.bool_], margin: int) -> NDArray[np.bool_]:
    """Pixels (h, w) within `margin` rows and columns of one that is looked at."""
    pixels = torch.from_numpy(looked_at)[None, None].float()
    return torch.nn.functional.max_pool2d(pixels, 2 * margin + 1, stride=1, padding=margin)[0, 0].numpy() > 0.0


def cells_of(width: int, height: int) -> tuple[int, int]:
    """Rows and columns of latent cells of an image."""
    return height // CELL_PIXELS, width // CELL_PIXELS


def _normal(seed: int, what: str, frame: int, height: int, width: int) -> Tensor:
    generator = torch.Generator().manual_seed(derive_seed(seed, what, frame))
    return torch.randn((LATENT_CHANNELS, height, width), generator=generator)


def _bytes(tensor: Tensor) -> bytes:
    return tensor.detach().cpu().float().contiguous().numpy().tobytes()
