"""The toy policy, two-stage fine-tuning, and the main job.

What a user of the package needs is here by name, and loaded when it is first asked for.
"""

from typing import TYPE_CHECKING

from olt_generator.lazy_names import lazy_names

if TYPE_CHECKING:
    from olt_sft_recipes.demo.main_job import DemoSettings as DemoSettings
    from olt_sft_recipes.demo.main_job import run_demo as run_demo
    from olt_sft_recipes.open_loop import evaluate_open_loop as evaluate_open_loop
    from olt_sft_recipes.toy.policy import load_toy as load_toy
    from olt_sft_recipes.training.stage_config import StageConfig as StageConfig
    from olt_sft_recipes.training.stage_config import builtin_stage_config as builtin_stage_config
    from olt_sft_recipes.training.stage_config import read_stage_config as read_stage_config
    from olt_sft_recipes.training.two_stages import train_on_mixture as train_on_mixture

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "demo.main_job": ("DemoSettings", "run_demo"),
        "open_loop": ("evaluate_open_loop",),
        "toy.policy": ("load_toy",),
        "training.stage_config": ("StageConfig", "builtin_stage_config", "read_stage_config"),
        "training.two_stages": ("train_on_mixture",),
    },
)
