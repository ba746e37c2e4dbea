"""The closed loop: scenes, sensors, control, vehicle, rollouts, and what they are worth.

What a user needs is here by its short name, and is loaded when it is first asked for: importing the package is cheap,
and who only scores loads no vehicle model.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from olt_closed_loop.control.tracking import ControlSettings
    from olt_closed_loop.evaluation.evaluation import load_scene, run_closed_loop, save_results
    from olt_closed_loop.evaluation.gate import check_gate
    from olt_closed_loop.evaluation.score_table import summarize_scores
    from olt_closed_loop.rollouts.rollout import Rollout, load_rollouts, save_rollouts
    from olt_closed_loop.rollouts.rollout_files import read_rollout_file
    from olt_closed_loop.scenes.procedural import generate_scene
    from olt_closed_loop.scenes.scene import Scene
    from olt_closed_loop.scenes.scene_file import read_scene, write_scene
    from olt_closed_loop.scoring.definitions import RolloutScore, score_record, score_rollout
    from olt_closed_loop.simulation.closed_loop import replay, simulate
    from olt_closed_loop.simulation.policies import make_policy
    from olt_closed_loop.simulation.settings import SimulationSettings

_MODULES = {
    "ControlSettings": "control.tracking",
    "Rollout": "rollouts.rollout",
    "RolloutScore": "scoring.definitions",
    "Scene": "scenes.scene",
    "SimulationSettings": "simulation.settings",
    "check_gate": "evaluation.gate",
    "generate_scene": "scenes.procedural",
    "load_rollouts": "rollouts.rollout",
    "load_scene": "evaluation.evaluation",
    "make_policy": "simulation.policies",
    "read_rollout_file": "rollouts.rollout_files",
    "read_scene": "scenes.scene_file",
    "replay": "simulation.closed_loop",
    "run_closed_loop": "evaluation.evaluation",
    "save_results": "evaluation.evaluation",
    "save_rollouts": "rollouts.rollout",
    "score_record": "scoring.definitions",
    "score_rollout": "scoring.definitions",
    "simulate": "simulation.closed_loop",
    "summarize_scores": "evaluation.score_table",
    "write_scene": "scenes.scene_file",
}
"""Where each name is defined."""

__all__ = [
    "ControlSettings",
    "Rollout",
    "RolloutScore",
    "Scene",
    "SimulationSettings",
    "check_gate",
    "generate_scene",
    "load_rollouts",
    "load_scene",
    "make_policy",
    "read_rollout_file",
    "read_scene",
    "replay",
    "run_closed_loop",
    "save_results",
    "save_rollouts",
    "score_record",
    "score_rollout",
    "simulate",
    "summarize_scores",
    "write_scene",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_MODULES])
