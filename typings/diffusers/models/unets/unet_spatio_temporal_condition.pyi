from typing import Any

from torch import nn

class UNetSpatioTemporalConditionModel(nn.Module):
    config: Any
