"""Depth Anything V2 (Yang et al., 2024) from a local folder, frame by frame, made metric by the clip's geometry."""

from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from olt_generator.distance.depth_source import RelativeDepth
from olt_generator.distance.model_folder import check_model_folder, load_network
from olt_generator.errors import InputError

# Length of the shorter side of what the network sees, of which it was trained on squares.
SHORTER_SIDE = 518
# Mean and spread of the colours of ImageNet, on which the backbone was trained.
MEAN = np.array([0.485, 0.456, 0.406], np.float32)
SPREAD = np.array([0.229, 0.224, 0.225], np.float32)


class DepthAnything(RelativeDepth):
    """Depth Anything, which sees one frame at a time.

    Args:
        folder: as published for transformers: `config.json` and `model.safetensors`.
        device: where the network runs.
        shorter_side: pixels of the shorter side of what the network sees; rounded to whole patches.

    Raises:
        InputError: transformers is not installed, the folder is incomplete, or it is another network.
    """

    def __init__(self, folder: Path, device: str = "cpu", shorter_side: int = SHORTER_SIDE) -> None:
        check_model_folder(folder, ("config.json", "model.safetensors"))
        try:
            from transformers import DepthAnythingForDepthEstimation
        except ImportError as error:
            raise InputError("Depth Anything needs transformers; pip install 'olt-generator[learned]'") from error
        self._model = load_network(DepthAnythingForDepthEstimation, folder, device)
        if self._model.config.depth_estimation_type != "relative":
            raise InputError(f"{folder}: a network of metric depth; give one of relative depth, such as V2-Small")
        self._device, self._shorter_side = device, shorter_side

    def relative_inverse_depth(self, frames: NDArray[np.uint8], wanted: NDArray[np.int64]) -> list[NDArray[np.float32]]:
        """See `RelativeDepth`."""
        return [self._look_at(frames[index]) for index in wanted]

    def _look_at(self, frame: NDArray[np.uint8]) -> NDArray[np.float32]:
        # What the network sees is whole patches.
        patch = self._model.config.patch_size
        factor = self._shorter_side / min(frame.shape[:2])
        height, width = (max(patch, round(factor * side / patch) * patch) for side in frame.shape[:2])
        resized = cv2.resize(frame, (width, height), interpolation=cv2.INTER_CUBIC).astype(np.float32)
        pixels = ((resized / 255.0 - MEAN) / SPREAD).transpose(2, 0, 1)[None].astype(np.float32)
        with torch.inference_mode():
            output = self._model(pixel_values=torch.from_numpy(pixels).to(self._device))
        return output.predicted_depth[0].float().cpu().numpy()
