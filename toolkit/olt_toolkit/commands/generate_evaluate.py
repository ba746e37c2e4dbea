"""`olt generate evaluate`: the paper's tables of an engine on clips that it was not trained on."""

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from olt_toolkit.commands.clip_options import DeviceOption, JsonOption

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from olt_generator.diffusion.training_clips import ClipVideos


class EvaluationSplit(StrEnum):
    """Scenes never seen, or other moments of scenes that were."""

    UNSEEN = "unseen"
    SEEN = "seen"


# Columns of the paper's tables, but for FID and FVD, whose networks are not part of this.
COLUMNS = {
    EvaluationSplit.UNSEEN: ("psnr", "lpips", "geokpm"),
    EvaluationSplit.SEEN: ("psnr", "ssim", "lpips"),
}
BESIDE = ("invented", "invented_psnr", "geometric_invented_psnr", "geometric_psnr")


def evaluate(
    run: Annotated[Path, typer.Argument(help="Folder of a training run: its cache and its engine are used.")],
    split: Annotated[EvaluationSplit, typer.Option(help="Which clips.")] = EvaluationSplit.UNSEEN,
    steps: Annotated[int, typer.Option(min=1, help="Euler steps of a view.")] = 50,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the noise.")] = 0,
    keep_observed: Annotated[bool, typer.Option(help="Keep what a warp saw, and generate the rest alone.")] = True,
    backbone: Annotated[Path | None, typer.Option(help="Folder of Wan2.1-VACE, for an engine without its own.")] = None,
    lpips_weights: Annotated[Path | None, typer.Option(help="Folder of LPIPS's weights.")] = None,
    loftr_weights: Annotated[Path | None, typer.Option(help="LoFTR's weights; SIFT without them.")] = None,
    device: DeviceOption = "cpu",
    picture: Annotated[
        Path | None, typer.Option(help="PNG to write: the first clip as it was, as warped and as generated.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Generate all views of the clips, and score them and the geometric engine's against the truth."""
    from olt_generator.diffusion.engine_folder import load_engine
    from olt_generator.diffusion.evaluation import sample_views, score_views
    from olt_generator.diffusion.observed_pixels import keep_observed as keep
    from olt_generator.diffusion.training_cache import TrainingCache
    from olt_generator.diffusion.training_state import read_settings
    from olt_generator.errors import InputError
    from olt_generator.views.pixel_origin import PixelOrigin
    from olt_toolkit.clips.score import open_lpips, open_matcher
    from olt_toolkit.runtime.console import print_json, show_progress

    if picture is not None and picture.suffix.lower() != ".png":
        raise InputError(f"{picture}: give a name that ends in .png")
    engine, cache = load_engine(run / "engine", backbone, device), TrainingCache(run / "cache")
    # An engine that never had a warp is not given one.
    use_warp = read_settings(run)["flow"]["use_warp"]
    numbers = cache.numbers(split.value)
    if not numbers:
        raise InputError(f"{run}: its cache holds no clip of the split {split.value}; train with a share of it")
    lpips, matcher = open_lpips(lpips_weights, device), open_matcher(loftr_weights, device)
    rows = []
    with show_progress("clips", len(numbers)) as (on_progress, _):
        for done, number in enumerate(numbers):
            videos = cache.videos(number)
            made = sample_views(engine, cache.clip(number), (1, 2, 3, 4, 5), steps, seed + done, use_warp)
            if keep_observed:
                made = {
                    view: keep(video, videos.filled[view], videos.origin[view] == PixelOrigin.INVENTED)
                    for view, video in made.items()
                }
            if picture is not None and done == 0:
                _draw(picture, videos, made)
            rows += [
                {"scene": cache.windows[number].scene, **asdict(score)}
                for score in score_views(videos, made, lpips, matcher)
            ]
            on_progress((done + 1) / len(numbers))
    result = summarise(rows, split, len(numbers))
    result |= {"steps": steps, "seed": seed, "keep_observed": keep_observed, "matcher": matcher.name, "clips": rows}
    result |= {"engine": engine.digest, "lpips": lpips.name if lpips else None}
    if as_json:
        print_json(result)
    else:
        _print(result, split)


def _draw(path: Path, videos: "ClipVideos", made: "dict[int, NDArray[np.uint8]]") -> None:
    """The last image of each view: the truth, the warp with what it invents tinted, and what the engine makes."""
    from olt_generator.diffusion.view_graph import VIEWS
    from olt_toolkit.clips.pictures import table_of_pictures, tint_invented, write_picture

    rows = {
        VIEWS[view]: [
            videos.truth[view][-1],
            tint_invented(videos.filled[view][-1], videos.origin[view][-1]),
            image[-1],
        ]
        for view, image in made.items()
    }
    write_picture(path, table_of_pictures(("as it was", "warped (invented: tinted)", "generated"), rows))


def summarise(rows: list[dict[str, Any]], split: EvaluationSplit, clips: int) -> dict[str, Any]:
    """The mean of each score of each view over the clips, None where none was measured, and how many scenes count.

    `gain` and `invented_gain` are dB above the geometric engine on the same clips, with 95 % intervals over scenes.
    """
    import numpy as np

    names, table = (*COLUMNS[split], *BESIDE), []
    for view in dict.fromkeys(row["view"] for row in rows):
        own = [row for row in rows if row["view"] == view]
        means: dict[str, Any] = {"view": view}
        for name in names:
            values = [row[name] for row in own if row.get(name) is not None]
            means[name] = float(np.mean(values)) if values else None
        for prefix in ("", "invented_"):
            means[f"{prefix}gain"], means[f"{prefix}gain_interval"] = _gain(own, prefix)
        table.append(means)
    return {"split": split.value, "n": clips, "scenes": len({row["scene"] for row in rows}), "views": table}


def _gain(rows: list[dict[str, Any]], prefix: str) -> tuple[float | None, tuple[float, float] | None]:
    """The mean over scenes of dB gained, and its 95 % Student t interval; None where one scene or none tells it."""
    import numpy as np
    from scipy import stats

    by_scene: dict[str, list[float]] = {}
    for row in rows:
        made, geometric = row.get(f"{prefix}psnr"), row.get(f"geometric_{prefix}psnr")
        if made is not None and geometric is not None:
            by_scene.setdefault(row["scene"], []).append(made - geometric)
    gains = np.array([np.mean(values) for values in by_scene.values()])
    if len(gains) < 2:
        return (float(gains[0]) if len(gains) else None), None
    mean, error = float(gains.mean()), float(stats.sem(gains))
    half = float(stats.t.ppf(0.975, len(gains) - 1)) * error
    return mean, (mean - half, mean + half)


def _print(result: dict[str, Any], split: EvaluationSplit) -> None:
    from olt_toolkit.runtime.console import format_cell, print_table

    names = ("view", *COLUMNS[split])
    title = f"{split.value}: {result['n']} clips of {result['scenes']} scenes, {result['steps']} steps"
    print_table(title, names, [[row[name] for name in names] for row in result["views"]])

    def word_gain(row: dict[str, Any], name: str) -> str:
        interval = row[f"{name}_interval"]
        told = "no interval" if interval is None else f"{interval[0]:+.2f} to {interval[1]:+.2f}"
        return format_cell(None) if row[name] is None else f"{row[name]:+.2f} ({told})"

    print_table(
        "Beside the geometric engine, PSNR in dB; gains with 95 % intervals over scenes",
        ("view", "no warp saw", "geometric there", "engine there", "gain there", "geometric", "engine", "gain"),
        [
            (
                row["view"],
                f"{row['invented']:.0%}",
                row["geometric_invented_psnr"],
                row["invented_psnr"],
                word_gain(row, "invented_gain"),
                row["geometric_psnr"],
                row["psnr"],
                word_gain(row, "gain"),
            )
            for row in result["views"]
        ],
    )
