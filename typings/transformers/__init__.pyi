from typing import Any

from torch import nn

class CLIPVisionModelWithProjection(nn.Module):
    config: Any

class DepthAnythingForDepthEstimation(nn.Module):
    config: Any
