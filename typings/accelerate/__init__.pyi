from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, TypeVar

from accelerate.utils import DistributedType, InitProcessGroupKwargs
from torch import Tensor, device, nn

__all__ = ["Accelerator", "DistributedType", "InitProcessGroupKwargs", "PartialState"]

_Module = TypeVar("_Module", bound=nn.Module)

class PartialState:
    is_main_process: bool
    num_processes: int
    process_index: int
    device: device
    distributed_type: DistributedType
    def __init__(self, cpu: bool = ...) -> None: ...
    def main_process_first(self) -> AbstractContextManager[None]: ...
    def wait_for_everyone(self) -> None: ...

class Accelerator:
    is_main_process: bool
    num_processes: int
    process_index: int
    device: device
    distributed_type: DistributedType
    log_with: list[Any]
    trackers: list[Any]
    def __init__(
        self,
        *,
        mixed_precision: str | None = ...,
        cpu: bool = ...,
        log_with: str | None = ...,
        project_dir: Path | str | None = ...,
        kwargs_handlers: Sequence[object] | None = ...,
    ) -> None: ...
    def main_process_first(self) -> AbstractContextManager[None]: ...
    def wait_for_everyone(self) -> None: ...
    def init_trackers(self, project_name: str, config: dict[str, Any] | None = ...) -> None: ...
    def log(self, values: dict[str, Any], step: int | None = ...) -> None: ...
    def reduce(self, tensor: Tensor, reduction: str = ...) -> Tensor: ...
    def prepare_model(self, model: _Module) -> _Module: ...
    def backward(self, loss: Tensor) -> None: ...
