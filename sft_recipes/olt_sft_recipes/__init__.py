"""The toy policy, two-stage fine-tuning, and the main job.

What a user of the package needs is here by name, and loaded when it is first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from olt_sft_recipes.demo.main_job import DemoSettings as DemoSettings
    from olt_sft_recipes.demo.main_job import run_demo as run_demo
    from olt_sft_recipes.open_loop import evaluate_open_loop as evaluate_open_loop
    from olt_sft_recipes.toy.policy import load_toy as load_toy
    from olt_sft_recipes.training.stage_config import StageConfig as StageConfig
    from olt_sft_recipes.training.stage_config import builtin_stage_config as builtin_stage_config
    from olt_sft_recipes.training.stage_config import read_stage_config as read_stage_config
    from olt_sft_recipes.training.two_stages import train_on_mixture as train_on_mixture

_MODULES = {
    "demo.main_job": ("DemoSettings", "run_demo"),
    "open_loop": ("evaluate_open_loop",),
    "toy.policy": ("load_toy",),
    "training.stage_config": ("StageConfig", "builtin_stage_config", "read_stage_config"),
    "training.two_stages": ("train_on_mixture",),
}
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return [*globals(), *_MODULE_OF]
