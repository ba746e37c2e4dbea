from pathlib import Path
from typing import Any, Self

class DPMSolverMultistepScheduler:
    def __init__(self, **config: Any) -> None: ...
    @classmethod
    def from_pretrained(cls, pretrained_model_name_or_path: Path, *, local_files_only: bool = ...) -> Self: ...
