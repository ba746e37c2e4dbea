"""Pictures and videos of the rollouts of a run."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from olt_closed_loop.evaluation.drive_views import DriveView, view_drive
from olt_closed_loop.evaluation.evaluation import load_scene
from olt_closed_loop.evaluation.run_folder import KeptRollout, describe_scene, read_finished
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scoring.definitions import score_rollout
from olt_generator.errors import InputError


@dataclass(frozen=True)
class Shown:
    """Files that show a rollout."""

    index: int
    picture: Path
    video: Path | None


def find_rollouts(run: Path, wanted: str | None = None) -> list[KeptRollout]:
    """The finished rollouts of a run, or the one of a number or of SCENE:SEED.

    Raises:
        InputError: there is no such run or rollout.
    """
    finished = read_finished(run)
    if wanted is None:
        return finished
    chosen = [kept for kept in finished if wanted in (str(kept.index), f"{kept.rollout.scene}:{kept.rollout.seed}")]
    if not chosen:
        raise InputError(
            f"{run}: has no finished rollout {wanted}; give a number or SCENE:SEED of the {len(finished)} that "
            "`olt closed-loop show RUN` lists"
        )
    return chosen


def summarize_rollout(kept: KeptRollout) -> dict[str, Any]:
    """What went well and wrong in a rollout; None is "not measured"."""
    rollout, score = kept.rollout, kept.score or {}
    return {
        "rollout": kept.index,
        "scene": rollout.scene,
        "seed": rollout.seed,
        "policy": rollout.policy,
        "score": score.get("score"),
        "reason": rollout.failure or score.get("reason"),
        "failure_kind": rollout.failure_kind,
        "seconds": 1e-6 * float(rollout.timestamps_us[-1] - rollout.timestamps_us[0]) if len(rollout.states) else 0.0,
        "plan_deviation_max": rollout.plan_deviation_max,
        "plan_deviation_rms": rollout.plan_deviation_rms,
        **vars(rollout.incidents),
    }


def show_rollouts(
    kept: Sequence[KeptRollout], out: Path, scene_source: str | None = None, video: bool = True
) -> list[Shown]:
    """Draw rollouts into a folder, NUMBER.png and NUMBER.mp4; those that failed before their first step have nothing.

    Args:
        kept: what to draw.
        out: where the files go.
        scene_source: the scene, where the run had it in memory only or it lies elsewhere now.
        video: whether to make videos too.

    Raises:
        InputError: a scene cannot be found or is not what was driven, or nothing of any rollout was driven.
    """
    from olt_closed_loop.evaluation.drive_pictures import draw_drive
    from olt_closed_loop.evaluation.drive_videos import film_drive

    driven = [one for one in kept if len(one.rollout.timestamps_us) > 1]
    if not driven:
        raise InputError(f"nothing was driven: {'; '.join(sorted({str(one.rollout.failure) for one in kept}))}")
    shown = []
    for one in driven:
        view = _view(one, scene_source)
        picture = out / f"{one.index:06d}.png"
        film = picture.with_suffix(".mp4") if video else None
        draw_drive(view, picture)
        if film:
            film_drive(view, film)
        shown.append(Shown(one.index, picture, film))
    return shown


def _view(kept: KeptRollout, scene_source: str | None) -> DriveView:
    scene = _scene_of(kept, scene_source)
    score = score_rollout(scene, kept.rollout, definition=kept.definition)  # pyright: ignore[reportArgumentType]
    return view_drive(scene, kept.rollout, score)


def _scene_of(kept: KeptRollout, scene_source: str | None) -> Scene:
    source = scene_source or kept.scene["source"]
    if source is None:
        raise InputError(f"scene {kept.rollout.scene} was driven from memory; write it to a file and give --scene FILE")
    if not scene_source and describe_scene(source) != kept.scene:
        raise InputError(f"scene {source} is not what was driven any more; give that one by --scene FILE")
    return load_scene(source)
