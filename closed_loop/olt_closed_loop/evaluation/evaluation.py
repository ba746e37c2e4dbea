"""Many rollouts: policies by name, scenes by path or seed, batches of rollouts on several processes."""

import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path

from olt_closed_loop.evaluation.gate import GateResult, check_gate
from olt_closed_loop.evaluation.refusals import refused_result
from olt_closed_loop.evaluation.score_table import summarize_scores
from olt_closed_loop.rollouts.rollout import Rollout, save_rollouts
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scoring.definitions import DefinitionName, RolloutScore, full_definition, score_rollout
from olt_closed_loop.simulation.closed_loop import RolloutRequest, simulate, simulate_batch
from olt_closed_loop.simulation.policies import make_policy
from olt_closed_loop.simulation.privileged_driver import ScenePolicy
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_closed_loop.suite.scenes import PREFIX, scene_of
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.omissions import Omission
from olt_generator.progress import Progress, silent
from olt_toolkit.runtime.workers import map_parallel

SceneSource = str | Scene
"""A scene, the path of a scene file or of a recorded drive, CATEGORY:SEED of a procedural one, or longtail/NAME."""

Result = tuple[Rollout, RolloutScore]

LARGEST_BATCH = 16
"""Rollouts that run in step: enough to share the calls of the policy, few enough to show progress."""
_load_policy = lru_cache(maxsize=2)(make_policy)


def run_closed_loop(
    scenes: Sequence[SceneSource],
    policy: str,
    rollouts: int = 2,
    seed: int = 0,
    settings: SimulationSettings | None = None,
    workers: int = 1,
    on_progress: Progress = silent,
    definition: DefinitionName = "strict",
    gated: bool = False,
) -> list[Result]:
    """Drive every scene `rollouts` times and score it, provided that the gate holds on it.

    A scene that cannot be read or driven, or fails the gate, loses itself alone: its rows are not valid and say why.

    Args:
        scenes: what to drive; a folder of recorded drives stands for each of them.
        policy: NAME or NAME:ARGUMENT (`simulation.policies.make_policy`).
        rollouts: drives a scene; drive i is seeded with `seed + i`.
        seed: first seed.
        settings: how to drive.
        workers: processes; the results do not depend on it.
        on_progress: told the share of rollouts that are done.
        definition: how to score (`scoring.definitions`).
        gated: whether the caller knows that the gate holds on all scenes with these settings and this definition, as
            from a run of another policy; then it is not asked again.

    Returns:
        Rollouts and scores, by scene in the order given and then by seed.

    Raises:
        InputError: the policy cannot be used, or no scene can.
    """
    if rollouts < 1:
        raise InputError(f"{rollouts} rollouts a scene: give 1 or more")
    settings = settings or SimulationSettings()
    runs = [(scene, seed + index) for scene in find_scenes(scenes) for index in range(rollouts)]
    size = min(LARGEST_BATCH, -(-len(runs) // (4 * workers)))
    batches = [runs[start : start + size] for start in range(0, len(runs), size)]
    run_batch = partial(_run_batch, policy_spec=policy, settings=settings, definition=definition, gated=gated)
    results = [result for results in map_parallel(run_batch, batches, workers, on_progress) for result in results]
    refusals = [rollout.failure for rollout, _ in results if rollout.failure and not len(rollout.timestamps_us)]
    if results and len(refusals) == len(results):
        raise InputError("; ".join(dict.fromkeys(refusals)))
    return results


def _run_batch(
    runs: list[tuple[SceneSource, int]],
    policy_spec: str,
    settings: SimulationSettings,
    definition: DefinitionName,
    gated: bool,
) -> list[Result]:
    policy = _load_policy(policy_spec)
    opened = {_key(source): source for source, _ in runs}
    ask = _taken_as_gated if gated else gate_scene
    gates = {key: ask(source, settings, definition) for key, source in opened.items()}
    driven = [
        (scene, seed) for source, seed in runs if (scene := gates[_key(source)][0]) and gates[_key(source)][1].passed
    ]
    if isinstance(policy, ScenePolicy):
        rollouts = [simulate(scene, policy.for_scene(scene), settings, seed) for scene, seed in driven]
    elif policy.cameras:  # one after another, so that one scene's textures are held at a time
        from olt_closed_loop.sensors.ray_casting import rig_sensors

        rollouts = [simulate(scene, policy, settings, seed, rig_sensors(scene)) for scene, seed in driven]
    elif driven:
        rollouts = simulate_batch([RolloutRequest(scene, seed) for scene, seed in driven], policy, settings)
    else:
        rollouts = []
    finished = iter(rollouts)
    results = []
    for source, seed in runs:
        scene, gate = gates[_key(source)]
        if scene is None or not gate.passed:
            results.append(refused_result(gate, scene.category if scene else "unknown", policy.name, seed, settings))
        else:
            rollout = next(finished)
            results.append((rollout, score_rollout(scene, rollout, settings.skip, definition)))
    return results


def _taken_as_gated(
    source: SceneSource, settings: SimulationSettings, definition: DefinitionName
) -> tuple[Scene | None, GateResult]:
    scene = load_scene(source)
    return scene, GateResult(scene.name, (), full_definition(definition))


def _key(source: SceneSource) -> str | int:
    return source if isinstance(source, str) else id(source)


def gate_scene(
    source: SceneSource, settings: SimulationSettings | None = None, definition: DefinitionName = "strict"
) -> tuple[Scene | None, GateResult]:
    """A scene, None if it cannot be loaded, and its gate; one that cannot be asked is refused with the reason."""
    scene = None
    try:
        scene = load_scene(source)
        return scene, check_gate(scene, settings, definition)
    except InputError as error:
        return scene, GateResult(
            scene.name if scene else str(source), (), full_definition(definition), refusal=str(error)
        )


def pass_gate(
    scenes: Sequence[SceneSource], settings: SimulationSettings | None = None, definition: DefinitionName = "strict"
) -> list[GateResult]:
    """Check that drives of known worth get what they are worth (`evaluation.gate.check_gate`); by scene.

    Raises:
        InputError: a scene cannot be loaded or driven, or a check fails on one, so that its scores would mean nothing.
    """
    results = [gate_scene(scene, settings, definition)[1] for scene in find_scenes(scenes)]
    refusals = [result.why_not for result in results if result.why_not]
    if refusals:
        raise InputError("; ".join(refusals))
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
    return source if isinstance(source, Scene) else _read_scene(source)


@lru_cache(maxsize=8)
def _read_scene(source: str) -> Scene:
    if Path(source).suffix in (".usda", ".usdc", ".usd"):
        from olt_closed_loop.scenes.scene_file import read_scene

        return read_scene(Path(source))
    if Path(source).exists():
        from olt_closed_loop.scenes.sources import read_recording

        return read_recording(Path(source))
    if source.startswith(PREFIX):
        return scene_of(source)
    category, colon, number = source.rpartition(":")
    if not colon or not number.isdecimal():
        raise InputError(
            f"scene {source!r}: give the path of a scene file or a recorded drive, CATEGORY:SEED such as cyclists:0, or "
            f"{PREFIX}NAME of the long-tail suite"
        )
    from olt_closed_loop.scenes.procedural import generate_scene

    return generate_scene(category, int(number))


def count_left_out(results: Sequence[Result]) -> dict[Omission, int]:
    """What was not computed and why, and in how many of the rollouts; numbers of one thing are added up."""
    rollouts: Counter[tuple[str, str]] = Counter()
    numbers: defaultdict[tuple[str, str], list[tuple[int, int]]] = defaultdict(list)
    for rollout, score in results:
        for omission in {*rollout.left_out, *score.left_out}:
            key = omission.what, omission.why
            rollouts[key] += 1
            if omission.count is not None and omission.total is not None:
                numbers[key].append((omission.count, omission.total))
    return {
        Omission(*key, *(sum(parts) for parts in zip(*numbers[key], strict=True))): rollouts[key]
        for key in sorted(rollouts)
    }


def count_vehicle_steps(results: Sequence[Result]) -> dict[str, int]:
    """Steps of all vehicles by model and method, such as "kinematic midpoint"."""
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
