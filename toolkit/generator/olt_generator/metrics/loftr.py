"""The matcher of the paper, LoFTR (Sun et al. 2021), as kornia has it."""

from pathlib import Path

import cv2
import torch

from olt_generator.errors import InputError
from olt_generator.metrics.matchers import Image, Matches
from olt_generator.metrics.weight_files import read_weights

# The paper's threshold.
MIN_CONFIDENCE = 0.6
# LoFTR puts the centre of a pixel half a pixel further.
PIXEL_OFFSET = 0.5


class LoftrMatcher:
    """Matches that LoFTR trusts more than 0.6, the threshold of the paper.

    Args:
        weights: a published checkpoint, `loftr_outdoor.ckpt` or `loftr_indoor.ckpt`, or its state dictionary as
            safetensors.
        device: where torch runs the network.

    Raises:
        InputError: kornia is not installed, or the file is missing or holds another network.
    """

    def __init__(self, weights: Path, device: str = "cpu") -> None:
        try:
            from kornia.feature import LoFTR
        except ImportError as error:
            raise InputError("LoFTR needs kornia; pip install 'olt-generator[learned]'") from error
        self.name = f"LoFTR ({weights.name}), confidence {MIN_CONFIDENCE}"
        self._device = device
        network = LoFTR(pretrained=None)
        try:
            network.load_state_dict(read_weights(weights))
        except RuntimeError as error:
            raise InputError(f"{weights}: not the weights of LoFTR; give loftr_outdoor.ckpt") from error
        self._network = network.to(device).eval()

    def match(self, image_a: Image, image_b: Image) -> Matches:
        """See `Matcher.match`."""
        with torch.inference_mode():
            found = self._network({"image0": self._tensor(image_a), "image1": self._tensor(image_b)})
        pixels_a, pixels_b, confidence = (
            found[key].double().cpu().numpy() for key in ("keypoints0", "keypoints1", "confidence")
        )
        return Matches(pixels_a - PIXEL_OFFSET, pixels_b - PIXEL_OFFSET).only(confidence > MIN_CONFIDENCE)

    def _tensor(self, image: Image) -> torch.Tensor:
        """Grey levels (1, 1, H, W) between 0 and 1."""
        gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        return torch.from_numpy(gray).to(self._device)[None, None] / 255.0
