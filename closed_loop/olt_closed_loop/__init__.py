"""The closed loop: scenes, sensors, control, vehicle, rollouts, and what they are worth.

What a user of the package needs is here by name, and loaded when it is first asked for: importing the package is cheap,
and who only scores loads no vehicle model.
"""

from typing import TYPE_CHECKING

from olt_generator.lazy_names import lazy_names

if TYPE_CHECKING:
    from olt_closed_loop.control.tracking import ControlSettings as ControlSettings
    from olt_closed_loop.evaluation.baselines import run_baselines as run_baselines
    from olt_closed_loop.evaluation.comparison import compare_scores as compare_scores
    from olt_closed_loop.evaluation.evaluation import count_left_out as count_left_out
    from olt_closed_loop.evaluation.evaluation import load_scene as load_scene
    from olt_closed_loop.evaluation.evaluation import pass_gate as pass_gate
    from olt_closed_loop.evaluation.evaluation import run_closed_loop as run_closed_loop
    from olt_closed_loop.evaluation.gate import check_gate as check_gate
    from olt_closed_loop.evaluation.run_folder import save_results as save_results
    from olt_closed_loop.evaluation.score_table import summarize_scores as summarize_scores
    from olt_closed_loop.hard_clips.filming import make_clip as make_clip
    from olt_closed_loop.hard_clips.kinds import list_hard_clips as list_hard_clips
    from olt_closed_loop.rollouts.rollout import Rollout as Rollout
    from olt_closed_loop.rollouts.rollout_files import read_rollout_file as read_rollout_file
    from olt_closed_loop.rollouts.rollout_tables import load_rollouts as load_rollouts
    from olt_closed_loop.rollouts.rollout_tables import save_rollouts as save_rollouts
    from olt_closed_loop.scenes.conditions import Conditions as Conditions
    from olt_closed_loop.scenes.procedural import generate_scene as generate_scene
    from olt_closed_loop.scenes.scene import Scene as Scene
    from olt_closed_loop.scenes.scene_file import read_scene as read_scene
    from olt_closed_loop.scenes.scene_file import write_scene as write_scene
    from olt_closed_loop.scoring.definitions import RolloutScore as RolloutScore
    from olt_closed_loop.scoring.definitions import score_record as score_record
    from olt_closed_loop.scoring.definitions import score_rollout as score_rollout
    from olt_closed_loop.sensors.camera_effects import CameraEffects as CameraEffects
    from olt_closed_loop.simulation.closed_loop import replay as replay
    from olt_closed_loop.simulation.closed_loop import simulate as simulate
    from olt_closed_loop.simulation.policies import make_policy as make_policy
    from olt_closed_loop.simulation.policy_hosts import PolicyLimits as PolicyLimits
    from olt_closed_loop.simulation.settings import SimulationSettings as SimulationSettings

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "control.tracking": ("ControlSettings",),
        "evaluation.baselines": ("run_baselines",),
        "evaluation.comparison": ("compare_scores",),
        "evaluation.evaluation": ("count_left_out", "load_scene", "pass_gate", "run_closed_loop"),
        "evaluation.run_folder": ("save_results",),
        "evaluation.gate": ("check_gate",),
        "evaluation.score_table": ("summarize_scores",),
        "hard_clips.filming": ("make_clip",),
        "hard_clips.kinds": ("list_hard_clips",),
        "rollouts.rollout": ("Rollout",),
        "rollouts.rollout_files": ("read_rollout_file",),
        "rollouts.rollout_tables": ("load_rollouts", "save_rollouts"),
        "scenes.conditions": ("Conditions",),
        "scenes.procedural": ("generate_scene",),
        "scenes.scene": ("Scene",),
        "scenes.scene_file": ("read_scene", "write_scene"),
        "scoring.definitions": ("RolloutScore", "score_record", "score_rollout"),
        "sensors.camera_effects": ("CameraEffects",),
        "simulation.closed_loop": ("replay", "simulate"),
        "simulation.policies": ("make_policy",),
        "simulation.policy_hosts": ("PolicyLimits",),
        "simulation.settings": ("SimulationSettings",),
    },
)
