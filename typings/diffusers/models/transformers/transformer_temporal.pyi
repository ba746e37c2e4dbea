from typing import Any

from torch import nn

class TransformerSpatioTemporalModel(nn.Module):
    config: Any
