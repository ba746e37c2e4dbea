"""Many rollouts: policies by name, scenes by path or seed, batches of rollouts on several processes."""

import json
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from olt_closed_loop.evaluation.gate import GateResult, check_gate
from olt_closed_loop.evaluation.score_table import summarize_scores
from olt_closed_loop.rollouts.rollout import Rollout, save_rollouts
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scoring.definitions import Definition, RolloutScore, score_rollout
from olt_closed_loop.simulation.closed_loop import RolloutRequest, Sensors, simulate, simulate_batch
from olt_closed_loop.simulation.policies import make_policy
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.progress import Progress, silent
from olt_toolkit.policy.contract import Policy
from olt_toolkit.runtime.workers import map_parallel

SceneSource = str | Scene
"""A scene, the path of its USD stage or of a recorded drive, or CATEGORY:SEED of a procedural one."""

Result = tuple[Rollout, RolloutScore]

LARGEST_BATCH = 16
"""Rollouts that run in step: enough to share the calls of the policy, few enough to show progress."""
_SHARE = re.compile(r"\b(\d+) of (\d+)\b")


def run_closed_loop(
    scenes: Sequence[SceneSource],
    policy: str,
    rollouts: int = 2,
    seed: int = 0,
    settings: SimulationSettings | None = None,
    workers: int = 1,
    on_progress: Progress = silent,
    definition: Definition = "strict",
) -> list[Result]:
    """Drive every scene `rollouts` times and score it, provided that the gate holds on it.

    Args:
        scenes: what to drive; a folder of recorded drives stands for each of them.
        policy: NAME or NAME:ARGUMENT (`simulation.policies.make_policy`).
        rollouts: drives a scene; drive i is seeded with `seed + i`.
        seed: first seed.
        settings: how to drive.
        workers: processes; the results do not depend on it.
        on_progress: told the share of rollouts that are done.
        definition: how to score (`scoring.definitions`).

    Returns:
        Rollouts and scores, by scene in the order given and then by seed.

    Raises:
        InputError: a scene or the policy cannot be used, or the gate fails on a scene.
    """
    if rollouts < 1:
        raise InputError(f"{rollouts} rollouts a scene: give 1 or more")
    settings = settings or SimulationSettings()
    drives = [(scene, seed + index) for scene in find_scenes(scenes) for index in range(rollouts)]
    size = min(LARGEST_BATCH, -(-len(drives) // (4 * workers)))
    batches = [
        _Batch(tuple(drives[start : start + size]), policy, settings, definition)
        for start in range(0, len(drives), size)
    ]
    return [result for results in map_parallel(_drive, batches, workers, on_progress) for result in results]


def pass_gate(scenes: Sequence[SceneSource], settings: SimulationSettings | None = None) -> list[GateResult]:
    """Check that drives of known worth get what they are worth (`scoring.gate.check_gate`); by scene.

    Raises:
        InputError: a scene cannot be loaded or driven, or a check fails on one, so that its scores would mean nothing.
    """
    results = [check_gate(load_scene(scene), settings) for scene in find_scenes(scenes)]
    failures = [
        f"scene {result.scene} ({check.name}: {check.finding})" for result in results for check in result.failed
    ]
    if failures:
        raise InputError(f"the gate fails on {'; '.join(failures)}: scores would mean nothing, repair the scene")
    return results


def find_scenes(sources: Sequence[SceneSource]) -> list[SceneSource]:
    """The scenes, with the recorded drives of a folder in its place."""
    scenes: list[SceneSource] = []
    for source in sources:
        if isinstance(source, str) and Path(source).is_dir():
            from olt_closed_loop.scenes.sources import find_recordings

            scenes.extend(str(path) for path in find_recordings(Path(source)))
        else:
            scenes.append(source)
    return scenes


def load_scene(source: SceneSource) -> Scene:
    """The scene itself.

    Raises:
        InputError: there is no such file, or it does not hold a scene, or no such category.
    """
    if isinstance(source, Scene):
        return source
    if Path(source).suffix in (".usda", ".usdc", ".usd"):
        return _read_scene(source)
    if Path(source).exists():
        return _read_recording(source)
    category, colon, number = source.rpartition(":")
    if not colon or not number.isdecimal():
        raise InputError(
            f"scene {source!r}: give the path of a USD stage or a recorded drive, or CATEGORY:SEED such as cyclists:0"
        )
    return _generate_scene(category, int(number))


def count_left_out(results: Sequence[Result]) -> dict[str, int]:
    """What was not computed and why, and in how many of the rollouts.

    Notes that differ in their "N of M" alone are put together, and their numbers added up.
    """
    rollouts: Counter[str] = Counter()
    shares: defaultdict[str, list[int]] = defaultdict(lambda: [0, 0])
    for rollout, score in results:
        for note in {*rollout.left_out, *score.left_out}:
            kind = _SHARE.sub("{} of {}", note)
            rollouts[kind] += 1
            for part, whole in _SHARE.findall(note):
                shares[kind][0] += int(part)
                shares[kind][1] += int(whole)
    return {kind.format(*shares[kind]): count for kind, count in sorted(rollouts.items())}


def count_vehicle_steps(results: Sequence[Result]) -> dict[str, int]:
    """Steps of all vehicles by the model and method that were taken."""
    steps: Counter[str] = Counter()
    for rollout, _ in results:
        steps.update(rollout.vehicle_steps)
    return dict(sorted(steps.items()))


def save_results(folder: Path, results: Sequence[Result]) -> None:
    """Write rollouts.json and scores.json into a folder, each whole or not at all."""
    save_rollouts(folder / "rollouts.json", [rollout for rollout, _ in results])
    scores = [score for _, score in results]
    report = {"table": summarize_scores(scores).to_dict(), "scores": [score.to_dict() for score in scores]}
    with write_whole(folder / "scores.json") as temporary:
        temporary.write_text(json.dumps(report, indent=2, allow_nan=False) + "\n")


@dataclass(frozen=True)
class _Batch:
    """Scenes and seeds to drive in one process."""

    drives: tuple[tuple[SceneSource, int], ...]
    policy: str
    settings: SimulationSettings
    definition: Definition


def _drive(batch: _Batch) -> list[Result]:
    policy = _load_policy(batch.policy)
    scenes = [load_scene(source) for source, _ in batch.drives]
    pass_gate(list({id(scene): scene for scene in scenes}.values()), batch.settings)
    drives = [(scene, seed) for scene, (_, seed) in zip(scenes, batch.drives, strict=True)]
    if policy.cameras:  # one after another, so that one scene's textures are held at a time
        rollouts = [simulate(scene, policy, batch.settings, seed, _make_sensors(scene)) for scene, seed in drives]
    else:
        rollouts = simulate_batch([RolloutRequest(scene, seed) for scene, seed in drives], policy, batch.settings)
    return [
        (rollout, score_rollout(scene, rollout, batch.settings.skip, batch.definition))
        for scene, rollout in zip(scenes, rollouts, strict=True)
    ]


@lru_cache(maxsize=2)
def _load_policy(spec: str) -> Policy:
    return make_policy(spec)


@lru_cache(maxsize=4)
def _read_scene(path: str) -> Scene:
    from olt_closed_loop.scenes.scene_file import read_scene

    return read_scene(Path(path))


@lru_cache(maxsize=4)
def _read_recording(path: str) -> Scene:
    from olt_closed_loop.scenes.sources import read_recording

    return read_recording(Path(path))


@lru_cache(maxsize=4)
def _generate_scene(category: str, seed: int) -> Scene:
    from olt_closed_loop.scenes.procedural import generate_scene

    return generate_scene(category, seed)


def _make_sensors(scene: Scene) -> Sensors:
    from olt_closed_loop.sensors.rig_sensors import RigSensors

    return RigSensors(scene)
