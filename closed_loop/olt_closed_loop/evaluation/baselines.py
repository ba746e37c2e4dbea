"""Policies that know nothing of the scene, driven beside every other: what a score is worth shows against theirs.

A policy that goes straight on ranked sixth of thirty on a public board (docs/formats/alpasim.md), so a table without
these says little. They need no cameras and draw nothing at random, so that one drive of each scene is enough.
"""

from collections.abc import Mapping, Sequence
from itertools import compress
from pathlib import Path

from olt_closed_loop.evaluation.comparison import Comparison, PairedDifference
from olt_closed_loop.evaluation.evaluation import Result, SceneSource, find_scenes, run_closed_loop
from olt_closed_loop.scoring.definitions import DefinitionName
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.progress import Progress, silent
from olt_toolkit.runtime.workers import Engine

BASELINES: Mapping[str, str] = {
    "constant speed": "constant_speed",
    "go straight": "constant_velocity",
    "stop": "standing",
    "route": "route",
}
"""What each baseline does, and the name of its policy."""


def run_baselines(
    scenes: Sequence[SceneSource],
    policy: str,
    seed: int = 0,
    settings: SimulationSettings | None = None,
    workers: int = 1,
    on_progress: Progress = silent,
    definition: DefinitionName = "strict",
    out: Path | None = None,
    engine: Engine = Engine.LOCAL,
    beside: Sequence[Result] = (),
) -> dict[str, list[Result]]:
    """Drive each scene once with each baseline but `policy` itself; by what they do.

    See `run_closed_loop`; each baseline has a folder of its own, by name of its policy, in `out`. Given `beside`, the
    results of the policy on the same scenes, those that the gate refused are left out, and it is not asked again.
    """
    if beside:
        sources = find_scenes(scenes)
        firsts = beside[:: len(beside) // len(sources)]
        gated = [rollout.failure_kind != "scene_refused" for rollout, _ in firsts]
        scenes = list(compress(sources, gated))
    others = {label: name for label, name in BASELINES.items() if name != policy}
    return {
        label: run_closed_loop(
            scenes,
            name,
            1,
            seed,
            settings,
            workers,
            lambda share, done=done: on_progress((done + share) / len(others)),
            definition,
            out / name if out else None,
            engine,
            gated=bool(beside),
        )
        for done, (label, name) in enumerate(others.items())
    }


def word_warnings(comparison: Comparison) -> list[str]:
    """A line for each baseline that the policy is not clearly better than, as far as these scenes can tell."""
    return [_word(difference) for difference in comparison.differences if _is_doubtful(difference)]


def _is_doubtful(difference: PairedDifference) -> bool:
    return difference.second in BASELINES and not (difference.separated and (difference.score or 0.0) > 0.0)


def _word(difference: PairedDifference) -> str:
    policy, baseline = difference.first, difference.second
    if difference.score is None:
        return f"{policy} and {baseline} are not compared: no scene has a score of both"
    limits = difference.score_interval
    known = f"95 % {limits[0]:+.3f} to {limits[1]:+.3f}" if limits else "no interval: too few scenes or no spread"
    found = f"AS differs by {difference.score:+.3f} ({known}) on {difference.scenes} scenes"
    if difference.separated:
        return f"{baseline} scores higher than {policy}: {found}"
    return f"{policy} is not clearly separated from {baseline}: {found}"
