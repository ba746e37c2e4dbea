from typing import Any

from torch import nn

class CLIPVisionModelWithProjection(nn.Module):
    config: Any

class DepthAnythingForDepthEstimation(nn.Module):
    config: Any

class AutoTokenizer:
    @classmethod
    def from_pretrained(cls, pretrained_model_name_or_path: Any, **options: Any) -> Any: ...

class UMT5EncoderModel(nn.Module):
    config: Any
