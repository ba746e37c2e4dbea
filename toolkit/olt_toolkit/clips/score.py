"""How good the views of a stored clip are: consistent, coherent, and close to those of a reference clip."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from olt_generator.errors import InputError
from olt_generator.metrics.coherence import Coherence, join_coherence, measure_coherence
from olt_generator.metrics.cross_view_consistency import (
    MAX_SAMPSON_ERROR,
    METRIC_HEIGHT,
    METRIC_WIDTH,
    Consistency,
    PosedView,
    join,
    measure_consistency,
)
from olt_generator.metrics.image_metrics import psnr, ssim
from olt_generator.metrics.matchers import Matcher
from olt_generator.progress import Progress, silent
from olt_toolkit.clips.images import fit_images
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, FRONT_TELE, FRONT_WIDE, REAR_LEFT, REAR_RIGHT, REAR_TELE

if TYPE_CHECKING:
    from olt_generator.metrics.lpips import Lpips

# The pairs of GeoKPM: neighbours around the vehicle. The front-tele view is cut out of the front view, has its centre,
# and would agree with it whatever it shows.
NEIGHBOURS = (
    (FRONT_WIDE, CROSS_LEFT),
    (FRONT_WIDE, CROSS_RIGHT),
    (CROSS_LEFT, REAR_LEFT),
    (CROSS_RIGHT, REAR_RIGHT),
    (REAR_LEFT, REAR_TELE),
    (REAR_RIGHT, REAR_TELE),
)


def open_matcher(loftr_weights: Path | None, device: str) -> Matcher:
    """LoFTR where its weights are given, SIFT otherwise."""
    if loftr_weights is None:
        from olt_generator.metrics.matchers import SiftMatcher

        return SiftMatcher()
    from olt_generator.metrics.loftr import LoftrMatcher

    return LoftrMatcher(loftr_weights, device)


def open_lpips(weights: Path | None, device: str) -> "Lpips | None":
    """LPIPS where its weights are given."""
    if weights is None:
        return None
    from olt_generator.metrics.lpips import Lpips

    return Lpips(weights, device)


def score_consistency(
    store: ClipStore, clip_id: str, matcher: Matcher, moments: int, on_progress: Progress = silent
) -> dict[str, Any]:
    """GeoKPM of a clip at so many moments, spread evenly: over all pairs of neighbouring views, and for each."""
    views = store.info(clip_id).views
    pairs = [pair for pair in NEIGHBOURS if set(pair) <= views.keys()]
    if not pairs:
        raise InputError(f"{store.root}: clip {clip_id} has no two neighbouring views to compare; it has {set(views)}")
    posed = _posed_views(store, clip_id, sorted({name for pair in pairs for name in pair}), moments)
    found = {}
    for done, (a, b) in enumerate(pairs):
        found[a, b] = measure_consistency(
            posed[a], posed[b], matcher, lambda part, done=done: on_progress((done + part) / len(pairs))
        )
    return {
        "matcher": matcher.name,
        "size": [METRIC_WIDTH, METRIC_HEIGHT],
        "max_sampson_error_px": MAX_SAMPSON_ERROR,
        **_describe_consistency(join(list(found.values()))),
        "pairs": [{"views": list(pair), **_describe_consistency(part)} for pair, part in found.items()],
    }


def score_coherence(
    store: ClipStore, clip_id: str, moments: int, on_progress: Progress = silent
) -> dict[str, dict[str, Any]]:
    """Coherence of each view that is not the front camera's own, over so many pairs of successive images.

    Raises:
        InputError: the clip has no front view.
    """
    views = store.info(clip_id).views
    if FRONT_WIDE not in views:
        raise InputError(
            f"{store.root}: clip {clip_id} has no {FRONT_WIDE} to hold its views against; it has {set(views)}"
        )
    names = [name for name in views if name not in (FRONT_WIDE, FRONT_TELE)]
    found = {}
    for done, name in enumerate(names):
        posed = _posed_views(store, clip_id, [FRONT_WIDE, name], moments, successive=2)
        pairs = range(0, len(posed[name].images), 2)
        parts = []
        for first in pairs:
            view, front = (_some(posed[each], slice(first, first + 2)) for each in (name, FRONT_WIDE))
            parts.append(measure_coherence(view, front))
            on_progress((done + len(parts) / len(pairs)) / len(names))
        found[name] = _describe_coherence(join_coherence(parts))
    return found


def score_against(
    store: ClipStore, clip_id: str, reference: ClipStore, reference_id: str, lpips: "Lpips | None" = None
) -> dict[str, Any]:
    """PSNR, SSIM and, where it is given, LPIPS of each view that both clips have, over the times of both.

    The reference is scaled to the size of the clip's views, which the result states. PSNR is that of the mean square
    error over all frames, and None where a view is identical.

    Raises:
        InputError: the clips share no view, or a view has no time in common.
    """
    shared = [name for name in store.info(clip_id).views if name in reference.info(reference_id).views]
    if not shared:
        raise InputError(f"clips {clip_id} and {reference_id} share no view; give a reference of the same rig")
    views = {name: _compare_view(store, clip_id, reference, reference_id, name, lpips) for name in shared}
    return {
        "clip_id": reference_id,
        "store": str(reference.root),
        "lpips": None if lpips is None else lpips.name,
        "views": views,
    }


def _posed_views(
    store: ClipStore, clip_id: str, names: list[str], moments: int, successive: int = 1
) -> dict[str, PosedView]:
    """Views at so many moments, spread evenly, or where it can be at so many `successive` images from each on."""
    motion = store.read_ego_motion(clip_id)
    timestamps = {name: store.read_timestamps(clip_id, name) for name in names}
    first = max(motion.span_us[0], *(int(times[0]) for times in timestamps.values()))
    last = min(motion.span_us[1], *(int(times[-1]) for times in timestamps.values()))
    times = timestamps[names[0]]
    times = times[(times >= first) & (times <= last)]
    if len(times) == 0:
        raise InputError(f"{store.root}: clip {clip_id}: its views have no time in common")
    successive = min(successive, len(times))
    first = np.linspace(0, len(times) - successive, min(moments, len(times))).round().astype(int)
    chosen = times[(first[:, None] + np.arange(successive)).ravel()]
    views = {}
    for name in names:
        images, taken_us = store.read_frames(clip_id, name, chosen)
        mounted = store.read_camera(clip_id, name)
        poses = motion.interpolate(np.maximum(taken_us, motion.span_us[0])) @ mounted.T_rig_camera
        views[name] = PosedView(images, mounted.camera, poses)
    return views


def _some(view: PosedView, kept: slice) -> PosedView:
    return PosedView(view.images[kept], view.camera, view.T_world_camera[kept])


def _describe_coherence(found: Coherence) -> dict[str, Any]:
    return {"percent": found.percent, "penalties": found.penalties, **asdict(found)}


def _describe_consistency(found: Consistency) -> dict[str, Any]:
    return {
        "percent": found.percent,
        "moments": len(found.matches),
        "moments_without_match": found.moments_without_match,
        "matches": int(found.matches.sum()),
        "valid": int(found.valid.sum()),
    }


def _compare_view(
    store: ClipStore, clip_id: str, reference: ClipStore, reference_id: str, name: str, lpips: "Lpips | None"
) -> dict[str, Any]:
    times_us = np.intersect1d(store.read_timestamps(clip_id, name), reference.read_timestamps(reference_id, name))
    if len(times_us) == 0:
        raise InputError(f"{name}: clips {clip_id} and {reference_id} show no moment in common")
    images, _ = store.read_frames(clip_id, name, times_us)
    height, width = images.shape[1:3]
    truth = fit_images(reference.read_frames(reference_id, name, times_us)[0], width, height)
    pairs = list(zip(images, truth, strict=True))
    mean_square = float(np.mean([10.0 ** (-0.1 * psnr(a, b)) for a, b in pairs]))
    return {
        "size": [width, height],
        "frames": len(times_us),
        "psnr": None if mean_square == 0.0 else -10.0 * float(np.log10(mean_square)),
        "ssim": float(np.mean([ssim(a, b) for a, b in pairs])),
        "lpips": None if lpips is None else float(np.mean([lpips(a, b) for a, b in pairs])),
    }
