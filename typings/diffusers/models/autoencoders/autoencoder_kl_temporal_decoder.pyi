from typing import Any

from torch import nn

class AutoencoderKLTemporalDecoder(nn.Module):
    config: Any
