"""The toy policy, two-stage fine-tuning, and the main job.

The names below are imported from their modules when they are first used, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from olt_sft_recipes.demo.main_job import DemoSettings, run_demo
    from olt_sft_recipes.open_loop import evaluate_open_loop
    from olt_sft_recipes.toy.policy import ToyPolicy, load_toy
    from olt_sft_recipes.training.stage_config import StageConfig, builtin_stage_config, read_stage_config
    from olt_sft_recipes.training.two_stages import StageResult, train_on_mixture

_MODULES = {
    "DemoSettings": "demo.main_job",
    "StageConfig": "training.stage_config",
    "StageResult": "training.two_stages",
    "ToyPolicy": "toy.policy",
    "builtin_stage_config": "training.stage_config",
    "evaluate_open_loop": "open_loop",
    "load_toy": "toy.policy",
    "read_stage_config": "training.stage_config",
    "run_demo": "demo.main_job",
    "train_on_mixture": "training.two_stages",
}

__all__ = [
    "DemoSettings",
    "StageConfig",
    "StageResult",
    "ToyPolicy",
    "builtin_stage_config",
    "evaluate_open_loop",
    "load_toy",
    "read_stage_config",
    "run_demo",
    "train_on_mixture",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
