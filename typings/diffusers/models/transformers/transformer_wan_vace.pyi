from typing import Any

from torch import Tensor, nn

class WanVACETransformer3DModel(nn.Module):
    config: Any
    peft_config: dict[str, Any]
    rope: nn.Module
    patch_embedding: nn.Module
    vace_patch_embedding: nn.Module
    condition_embedder: nn.Module
    blocks: nn.ModuleList
    vace_blocks: nn.ModuleList
    norm_out: nn.Module
    proj_out: nn.Module
    scale_shift_table: Tensor
    _keep_in_fp32_modules: list[str] | None
    def __init__(self, **config: Any) -> None: ...
    def add_adapter(self, adapter_config: object, adapter_name: str = ...) -> None: ...
    def delete_adapters(self, adapter_names: list[str] | str) -> None: ...
