"""How close generated views come to the true ones: the paper's tables, beside the geometric engine on the same clips.

Paper, tables of unseen scenes (PSNR, LPIPS, GeoKPM a view) and of seen ones (PSNR, SSIM, LPIPS). The paper's FID and
FVD are left out: their networks are not part of this.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from olt_generator.cameras import PinholeCamera
from olt_generator.diffusion.engine_folder import Engine
from olt_generator.diffusion.flow_training import collect_conditions, move
from olt_generator.diffusion.generation import GenerationSettings, sample_view
from olt_generator.diffusion.training_clips import ClipVideos, TrainingClip
from olt_generator.diffusion.view_graph import CONDITIONS, VIEWS
from olt_generator.metrics.cross_view_consistency import PosedView, measure_consistency
from olt_generator.metrics.image_metrics import psnr, ssim
from olt_generator.metrics.lpips import MIN_SIDE, Lpips
from olt_generator.metrics.matchers import Matcher
from olt_generator.seeds import derive_seed
from olt_generator.views.pixel_origin import PixelOrigin

Video = NDArray[np.uint8]


@dataclass(frozen=True)
class ViewScore:
    """Scores of a view of a clip; None is not measured.

    Attributes:
        view: its name.
        psnr, geometric_psnr: dB over all pixels that the real lens shows, of the generated view and of the geometric
            engine's.
        invented_psnr, geometric_invented_psnr: the same over pixels that no warp saw; None where it saw all.
        invented: share of those.
        ssim, lpips: means over the images, of the generated view.
        geokpm: percent, mean over the views that it is conditioned on.
    """

    view: str
    psnr: float
    geometric_psnr: float
    invented_psnr: float | None
    geometric_invented_psnr: float | None
    invented: float
    ssim: float
    lpips: float | None
    geokpm: float | None


@torch.inference_mode()
def sample_views(
    engine: Engine,
    clip: TrainingClip,
    views: Sequence[int],
    steps: int,
    seed: int,
    use_warp: bool = True,
) -> dict[int, Video]:
    """Generated videos (f, h, w, 3) by view id, each conditioned on those generated before it.

    Args:
        clip: as the network takes it.
        views: ids in an order in which all that a view is conditioned on comes before it (`view_graph.order_views`).
        steps: Euler steps; one step from pure noise tells the mean of what the model holds possible.
    """
    settings = GenerationSettings(steps=steps, cross_guidance=1.0, rear_guidance=1.0)
    latents = {0: clip.latents[0]}
    for view in views:
        seen = [[latents[condition] for condition in CONDITIONS[view]]]
        conditions = move(collect_conditions([clip], [view], engine.prompt.cpu(), seen, use_warp), engine.device)
        generator = torch.Generator().manual_seed(derive_seed("evaluation", seed, view))
        noise = torch.randn(clip.latents[:1].shape, generator=generator)
        latents[view] = sample_view(engine, view, conditions, noise, settings)[0]
    return {view: engine.codec.decode(latents[view][None])[0].cpu().numpy() for view in views}


def score_views(
    videos: ClipVideos, made: dict[int, Video], lpips: Lpips | None = None, matcher: Matcher | None = None
) -> list[ViewScore]:
    """Scores of generated views (f, h, w, 3) by id against the truth."""
    return [_score_view(videos, made, view, lpips, matcher) for view in made]


def _score_view(
    videos: ClipVideos, made: dict[int, Video], view: int, lpips: Lpips | None, matcher: Matcher | None
) -> ViewScore:
    truth, filled, image = videos.truth[view], videos.filled[view], made[view]
    known = np.broadcast_to(videos.known[view], truth.shape[:3])
    invented = known & (videos.origin[view] == PixelOrigin.INVENTED)
    large = min(truth.shape[1:3]) >= MIN_SIDE
    return ViewScore(
        VIEWS[view],
        psnr(image, truth, known),
        psnr(filled, truth, known),
        psnr(image, truth, invented) if invented.any() else None,
        psnr(filled, truth, invented) if invented.any() else None,
        float(invented.sum() / known.sum()),
        float(np.mean([ssim(a, b) for a, b in zip(image, truth, strict=True)])),
        float(np.mean([lpips(a, b) for a, b in zip(image, truth, strict=True)])) if lpips and large else None,
        _consistency(videos, made, view, matcher) if matcher else None,
    )


def _consistency(videos: ClipVideos, made: dict[int, Video], view: int, matcher: Matcher) -> float | None:
    all_views = {0: videos.truth[0], **made}
    posed = {
        number: PosedView(all_views[number], _camera(videos, number), videos.poses[number])
        for number in (view, *CONDITIONS[view])
        if number in all_views
    }
    found = [
        measure_consistency(posed[view], posed[other], matcher).percent for other in CONDITIONS[view] if other in posed
    ]
    measured = [value for value in found if value is not None]
    return float(np.mean(measured)) if measured else None


def _camera(videos: ClipVideos, view: int) -> PinholeCamera:
    height, width = videos.truth.shape[2:4]
    return PinholeCamera(width, height, *(float(value) for value in videos.lenses[view]))
