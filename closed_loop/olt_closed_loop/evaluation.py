"""Many rollouts: policies by name, scenes by path or seed, one process a rollout."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from olt_closed_loop.gate import GateResult, check_gate
from olt_closed_loop.policies import make_policy
from olt_closed_loop.rollout import Rollout, save_rollouts
from olt_closed_loop.scene import Scene
from olt_closed_loop.score_table import summarize_scores
from olt_closed_loop.scoring import RolloutScore, score_rollout
from olt_closed_loop.simulation import Sensors, SimulationSettings, simulate
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.progress import Progress, silent
from olt_toolkit.policy import Policy
from olt_toolkit.workers import map_parallel

SceneSource = str | Scene
"""A scene, the path of its USD stage, or CATEGORY:SEED of a procedural one."""


def run_closed_loop(
    scenes: Sequence[SceneSource],
    policy: str,
    rollouts: int = 2,
    seed: int = 0,
    settings: SimulationSettings | None = None,
    workers: int = 1,
    on_progress: Progress = silent,
) -> list[tuple[Rollout, RolloutScore]]:
    """Drive every scene `rollouts` times and score it.

    Args:
        scenes: what to drive.
        policy: NAME or NAME:ARGUMENT (`olt_closed_loop.policies.make_policy`).
        rollouts: drives a scene; drive i is seeded with `seed + i`.
        seed: first seed.
        settings: how to drive.
        workers: processes; the results do not depend on it.
        on_progress: told the share of rollouts that are done.

    Returns:
        Rollouts and scores, by scene in the order given and then by seed.

    Raises:
        InputError: a scene or the policy cannot be used.
    """
    if rollouts < 1:
        raise InputError(f"{rollouts} rollouts a scene: give 1 or more")
    settings = settings or SimulationSettings()
    work = [_Work(scene, policy, seed + index, settings) for scene in scenes for index in range(rollouts)]
    return map_parallel(_drive, work, workers, on_progress)


def pass_gate(scenes: Sequence[SceneSource]) -> list[GateResult]:
    """Check that drives of known worth get what they are worth (`olt_closed_loop.gate.check_gate`); by scene.

    Raises:
        InputError: a scene cannot be loaded or driven, or a check fails on one, so that its scores would mean nothing.
    """
    results = [check_gate(load_scene(scene)) for scene in scenes]
    failures = [
        f"scene {result.scene} ({check.name}: {check.finding})" for result in results for check in result.failed
    ]
    if failures:
        raise InputError(f"the gate fails on {'; '.join(failures)}: scores would mean nothing, repair the scene")
    return results


def load_scene(source: SceneSource) -> Scene:
    """The scene itself.

    Raises:
        InputError: there is no such file, or it does not hold a scene, or no such category.
    """
    if isinstance(source, Scene):
        return source
    if Path(source).suffix in (".usda", ".usdc", ".usd"):
        return _read_scene(source)
    category, colon, number = source.rpartition(":")
    if not colon or not number.isdecimal():
        raise InputError(f"scene {source!r}: give the path of a USD stage, or CATEGORY:SEED such as cyclists:0")
    return _generate_scene(category, int(number))


def save_results(folder: Path, results: Sequence[tuple[Rollout, RolloutScore]]) -> None:
    """Write rollouts.json and scores.json into a folder, each whole or not at all."""
    save_rollouts(folder / "rollouts.json", [rollout for rollout, _ in results])
    scores = [score for _, score in results]
    report = {"table": summarize_scores(scores).to_dict(), "scores": [score.to_dict() for score in scores]}
    with write_whole(folder / "scores.json") as temporary:
        temporary.write_text(json.dumps(report, indent=2, allow_nan=False) + "\n")


@dataclass(frozen=True)
class _Work:
    scene: SceneSource
    policy: str
    seed: int
    settings: SimulationSettings


def _drive(work: _Work) -> tuple[Rollout, RolloutScore]:
    scene, policy = load_scene(work.scene), _load_policy(work.policy)
    sensors = _make_sensors(scene) if policy.cameras else None
    rollout = simulate(scene, policy, work.settings, work.seed, sensors)
    return rollout, score_rollout(scene, rollout)


@lru_cache(maxsize=2)
def _load_policy(spec: str) -> Policy:
    return make_policy(spec)


@lru_cache(maxsize=4)
def _read_scene(path: str) -> Scene:
    from olt_closed_loop.stage import read_scene

    return read_scene(Path(path))


@lru_cache(maxsize=4)
def _generate_scene(category: str, seed: int) -> Scene:
    from olt_closed_loop.procedural import generate_scene

    return generate_scene(category, seed)


def _make_sensors(scene: Scene) -> Sensors:
    from olt_closed_loop.rig_sensors import RigSensors

    return RigSensors(scene)
