"""The geometry encoder: one encoding of rays, camera, role and ego motion for all branches of the network.

Paper, section Geometry Conditioning: g = phi_plucker(r) + e_cam(v) + e_role(r) + phi_traj(T_anchor).
"""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from olt_generator.diffusion.view_graph import VIEWS
from olt_generator.poses import Array, invert
from olt_generator.twists import vector_from_rotation


class Role(IntEnum):
    """What tokens are there for: to be generated, or to condition others."""

    TARGET = 0
    CONDITION = 1


class GeometryEncoder(nn.Module):
    """Encodes where the tokens of a view look and how the vehicle moves.

    All last layers and embeddings start at zero, so that the backbone starts as it was trained.

    Args:
        dim: width of a token.
        hidden: hidden width of the MLPs.
        plucker: False to leave the rays out.
    """

    def __init__(self, dim: int, hidden: int, plucker: bool = True) -> None:
        super().__init__()
        self.rays = _mlp(6, hidden, dim) if plucker else None
        self.motion = _mlp(6, hidden, dim)
        self.camera = _zeros(nn.Embedding(len(VIEWS), dim))
        self.role = _zeros(nn.Embedding(len(Role), dim))

    def forward(self, rays: Tensor, camera: Tensor, role: Role, motion: Tensor) -> Tensor:
        """Encodings (b, t h w, dim), float32 or as autocast makes them.

        Args:
            rays: (b, 6, t, h, w) of `views.plucker.plucker_rays`, one a token.
            camera: (b,) view ids.
            motion: (b, t, 6) of `ego_motion_features`.
        """
        dtype = self.camera.weight.dtype
        of_view = self.camera(camera) + self.role.weight[role]
        of_frame = self.motion(motion.to(dtype)) + of_view[:, None]
        encoding = of_frame[:, :, None].expand(-1, -1, rays.shape[3] * rays.shape[4], -1)
        if self.rays is not None:
            # (b, 6, t, h, w) -> (b, t, h w, 6)
            encoding = encoding + self.rays(rays.to(dtype).flatten(3).permute(0, 2, 3, 1))
        return encoding.flatten(1, 2)


def ego_motion_features(T_anchor_front: Array) -> NDArray[np.float32]:
    """How the front camera moved since the latent frame before, (n, 6): metres in its old axes, then a rotation vector.

    Args:
        T_anchor_front: (n, 4, 4) poses of the front camera at the latent frames; zeros stand for the first of them.
    """
    steps = invert(T_anchor_front[:-1]) @ T_anchor_front[1:]
    features = np.zeros((len(T_anchor_front), 6), np.float32)
    features[1:, :3], features[1:, 3:] = steps[:, :3, 3], vector_from_rotation(steps[:, :3, :3])
    return features


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.SiLU(), zero_linear(hidden, outputs))


def zero_linear(inputs: int, outputs: int) -> nn.Linear:
    """A linear layer that says nothing until it is trained."""
    layer = nn.Linear(inputs, outputs)
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


def _zeros(embedding: nn.Embedding) -> nn.Embedding:
    nn.init.zeros_(embedding.weight)
    return embedding
