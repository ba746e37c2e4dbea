"""Many rollouts: policies by name, scenes by path or seed, batches of rollouts on several processes."""

import pickle
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from uuid import uuid4

from olt_closed_loop.evaluation.gate import GateResult, check_gate
from olt_closed_loop.evaluation.run_folder import describe_run, open_run, save_part
from olt_closed_loop.rollouts.rollout import Rollout
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scoring.definitions import (
    DefinitionName,
    RolloutScore,
    full_definition,
    score_failed,
    score_rollout,
)
from olt_closed_loop.simulation.answers import PolicyFault, word_error
from olt_closed_loop.simulation.closed_loop import drive, simulate
from olt_closed_loop.simulation.policies import make_policy
from olt_closed_loop.simulation.policy_hosts import PolicyHost, PolicyLimits, PolicySource, is_of_package
from olt_closed_loop.simulation.policy_process import PolicyNotStarted, host_policy
from olt_closed_loop.simulation.running_rollout import RolloutRequest
from olt_closed_loop.simulation.scene_policy import ScenePolicy
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_closed_loop.suite.scenes import PREFIX, scene_of
from olt_closed_loop.suite.training import PREFIX as TRAINING_PREFIX
from olt_closed_loop.suite.training import training_scene_of
from olt_generator.errors import InputError
from olt_generator.omissions import Omission
from olt_generator.progress import Progress, silent
from olt_toolkit.runtime.workers import Engine, map_parallel

SceneSource = str | Scene
"""A scene, the path of a scene file or of a recorded drive, CATEGORY:SEED of a procedural one, or longtail/NAME."""

Result = tuple[Rollout, RolloutScore]

LARGEST_BATCH = 16
"""Rollouts that run in step: enough to share the calls of the policy, few enough to show progress."""


@dataclass(frozen=True)
class _Run:
    """One rollout to make, or that an earlier run kept."""

    index: int
    source: SceneSource
    seed: int
    kept: Rollout | None = None


def run_closed_loop(
    scenes: Sequence[SceneSource],
    policy: PolicySource,
    rollouts: int = 2,
    seed: int = 0,
    settings: SimulationSettings | None = None,
    workers: int = 1,
    on_progress: Progress = silent,
    definition: DefinitionName = "strict",
    out: Path | None = None,
    engine: Engine = Engine.LOCAL,
    gated: bool = False,
) -> list[Result]:
    """Drive every scene `rollouts` times and score it, provided that the gate holds on it.

    A scene that cannot be loaded, or on which the gate fails, loses its own rollouts only: they are not valid, with the
    kind "scene_refused" and the reason. What a policy does wrong ends its own rollout only (`simulation.closed_loop`).

    Args:
        scenes: what to drive; a folder of recorded drives stands for each of them.
        policy: NAME or NAME:ARGUMENT (`simulation.policies.make_policy`), a policy, or a factory of policies. Every
            rollout gets it in the same state (`simulation.policy_hosts`).
        rollouts: drives a scene; drive i is seeded with `seed + i`.
        seed: first seed.
        settings: how to drive.
        workers: processes; the results do not depend on it.
        on_progress: told the share of rollouts that are done.
        definition: how to score (`scoring.definitions`).
        out: folder in which finished rollouts are kept, and found again by the next run with the same options, and
            which holds the results in the end (`evaluation.run_folder`).
        engine: processes of this machine, or a Ray cluster whose machines see the same files.
        gated: whether the caller knows that the gate holds on all scenes with these settings and this definition, as
            from a run of another policy; then it is not asked again.

    Returns:
        Rollouts and scores, by scene in the order given and then by seed.

    Raises:
        InputError: the policy cannot be used, no scene can, or `out` holds a run with other options.
    """
    if rollouts < 1:
        raise InputError(f"{rollouts} rollouts a scene: give 1 or more")
    settings = _with_isolation(settings or SimulationSettings(), policy)
    _refuse_unpicklable(policy, workers, engine)
    sources = find_scenes(scenes)
    options = describe_run(sources, policy, rollouts, seed, settings, definition) if out else {}
    with open_run(out, options) if out else nullcontext() as folder:
        kept = folder.kept() if folder else {}
        drives = [(source, seed + index) for source in sources for index in range(rollouts)]
        runs = [_Run(index, source, number, kept.get(index)) for index, (source, number) in enumerate(drives)]
        job = _Job(uuid4().hex, policy, settings, definition, folder.parts if folder else None, gated)
        size = min(LARGEST_BATCH, -(-len(runs) // (4 * workers)))
        size += -size % min(rollouts, LARGEST_BATCH)  # a scene whose rollouts are in one batch is gated once
        batches = [runs[start : start + size] for start in range(0, len(runs), size)]
        try:
            parts = map_parallel(job.run_batch, batches, workers, on_progress, engine)
        finally:
            _close_host()
        results = [result for part in parts for result in part]
        _refuse_if_all_scenes_fail(results)
        if folder:
            folder.complete(results)
    return results


def _with_isolation(settings: SimulationSettings, policy: PolicySource) -> SimulationSettings:
    """Settings whose isolation is decided: the policies of this package are trusted, all others get a process."""
    if settings.limits.isolate != "auto":
        return settings
    isolate = "none" if is_of_package(policy) else "process"
    return replace(settings, limits=replace(settings.limits, isolate=isolate))


def _refuse_unpicklable(policy: PolicySource, workers: int, engine: Engine) -> None:
    if workers <= 1 and engine is Engine.LOCAL:
        return
    try:
        pickle.dumps(policy)
    except Exception as error:  # objects say it in many ways
        raise InputError(
            f"policy {type(policy).__name__} is not picklable ({word_error(error)}), so it cannot go to {workers} "
            "workers; define it at the top of a module, or give workers=1"
        ) from error


def _refuse_if_all_scenes_fail(results: Sequence[Result]) -> None:
    reasons = {rollout.failure: None for rollout, _ in results if rollout.failure_kind == "scene_refused"}
    if results and all(rollout.failure_kind == "scene_refused" for rollout, _ in results):
        raise InputError("; ".join(map(str, reasons)))


@dataclass(frozen=True)
class _Job:
    """What all batches of a run share; `key` tells the runs of a process apart."""

    key: str
    policy: PolicySource
    settings: SimulationSettings
    definition: DefinitionName
    parts: Path | None
    gated: bool

    def run_batch(self, runs: list[_Run]) -> list[Result]:
        """Rollouts and scores of a batch, in order; each finished rollout is kept at once."""
        rollouts = {run.index: run.kept for run in runs if run.kept}
        scenes: dict[int, Scene] = {}
        missing = [run for run in runs if not run.kept]
        name = self._policy_name(missing)
        checked = {_key(run.source): self._check_scene(run.source) for run in _one_a_scene(missing)}
        for run in missing:
            scene = checked[_key(run.source)]
            if isinstance(scene, Scene):
                scenes[run.index] = scene
            else:
                rollouts[run.index] = _not_driven(run, name, "scene_refused", scene)
        for run, rollout in self._drive([run for run in missing if run.index in scenes], scenes, name):
            rollouts[run.index] = rollout
            if self.parts:
                save_part(self.parts, run.index, rollout)
        return [(rollouts[run.index], self._score(run, rollouts[run.index])) for run in runs]

    def _check_scene(self, source: SceneSource) -> Scene | str:
        """The scene if it can be driven and the gate holds on it, or why not."""
        trusted = replace(self.settings, limits=PolicyLimits(isolate="none"))  # the gate has no foreign policy
        try:
            if self.gated:
                return load_scene(source)
            scene, gate = gate_scene(source, trusted, self.definition)
        except Exception as error:  # whatever is wrong with one scene, the others are driven
            name = source if isinstance(source, str) else source.name
            return f"scene {name}: {type(error).__name__}: {word_error(error)}"
        return scene if scene and gate.passed else gate.why_not or ""

    def _policy_name(self, missing: Sequence[_Run]) -> str:
        host = _host_of(self) if missing else None
        return host.traits.name if isinstance(host, PolicyHost) else _name_of(self.policy)

    def _drive(self, runs: list[_Run], scenes: dict[int, Scene], name: str) -> Iterator[tuple[_Run, Rollout]]:
        if not runs:
            return
        host = _host_of(self)
        if isinstance(host, PolicyFault):
            for run in runs:
                scene = scenes[run.index]
                reason = f"the policy {host.what}{f': {host.detail}' if host.detail else ''}"
                yield run, Rollout.not_driven(scene.name, scene.category, name, run.seed, host.kind, reason)
        elif knows_scenes := _scene_policy(self.policy):
            for run in runs:
                scene = scenes[run.index]
                yield run, simulate(scene, knows_scenes.for_scene(scene), self.settings, run.seed)
        elif host.traits.cameras:  # one after another, so that one scene's textures are held at a time
            from olt_closed_loop.sensors.ray_casting import rig_sensors

            for _, of_scene in groupby(runs, lambda run: _key(run.source)):
                sensors = None
                for run in of_scene:
                    scene = scenes[run.index]
                    sensors = sensors or rig_sensors(scene, self.settings.conditions)
                    yield run, next(drive([RolloutRequest(scene, run.seed, sensors)], host, self.settings))
        else:
            requests = [RolloutRequest(scenes[run.index], run.seed) for run in runs]
            yield from zip(runs, drive(requests, host, self.settings), strict=True)

    def _score(self, run: _Run, rollout: Rollout) -> RolloutScore:
        if rollout.failure:
            return score_failed(rollout, self.definition)
        return score_rollout(load_scene(run.source), rollout, self.settings.skip, self.definition)


def _scene_policy(policy: PolicySource) -> ScenePolicy | None:
    """A policy of this package that must be told which scene it drives; None for all others."""
    if isinstance(policy, str) and is_of_package(policy):
        policy = make_policy(policy)
    return policy if isinstance(policy, ScenePolicy) else None


_open_host: tuple[str, PolicyHost | PolicyFault] | None = None
"""The policy of the run that this process works on; it stays from batch to batch, because checkpoints load slowly."""


def _host_of(job: _Job) -> PolicyHost | PolicyFault:
    """The policy where it is to run, or why its process could not build it."""
    global _open_host
    if _open_host is None or _open_host[0] != job.key:
        _close_host()
        try:
            host = host_policy(job.policy, job.settings.limits)
        except PolicyNotStarted as error:
            host = error.fault
        _open_host = job.key, host
    return _open_host[1]


def _close_host() -> None:
    global _open_host
    if _open_host and isinstance(_open_host[1], PolicyHost):
        _open_host[1].close()
    _open_host = None


def _name_of(policy: PolicySource) -> str:
    named = policy if isinstance(policy, str) else getattr(policy, "name", None)
    return named if isinstance(named, str) else getattr(policy, "__name__", type(policy).__name__)


def _not_driven(run: _Run, policy: str, kind: str, reason: str) -> Rollout:
    try:
        scene = load_scene(run.source)
        name, category = scene.name, scene.category
    except Exception:  # that is the reason
        name, category = str(run.source), "unknown"
    return Rollout.not_driven(name, category, policy, run.seed, kind, reason)


def _key(source: SceneSource) -> str | int:
    return source if isinstance(source, str) else id(source)


def _one_a_scene(runs: Sequence[_Run]) -> list[_Run]:
    return list({_key(run.source): run for run in runs}.values())


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
    """The scenes, with the recorded drives of a folder, or of a file of many, in its place."""
    scenes: list[SceneSource] = []
    for source in sources:
        if isinstance(source, str) and (Path(source).is_dir() or ".tfrecord" in source):
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
    if Path(source).exists() or "#" in source:
        from olt_closed_loop.scenes.sources import read_recording

        return read_recording(Path(source))
    if source.startswith(PREFIX):
        return scene_of(source)
    if source.startswith(TRAINING_PREFIX):
        return training_scene_of(source)
    category, colon, number = source.rpartition(":")
    if not colon or not number.isdecimal():
        raise InputError(
            f"scene {source!r}: give the path of a scene file or a recorded drive, CATEGORY:SEED such as cyclists:0, "
            f"{PREFIX}NAME of the long-tail suite, or {TRAINING_PREFIX}NAME:SEED of the drives to learn from"
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
