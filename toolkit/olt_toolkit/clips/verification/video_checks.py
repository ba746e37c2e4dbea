"""Whether videos decode, to the frames that their tables promise, as the public reader counts them."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.origin_files import OriginRuns
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.decoded_videos import ClipVideos, DecodedVideo
from olt_toolkit.clips.verification.findings import Finding, judge, not_compared, state

RATE_FACTOR = 1.5
"""Between the rate that a video states and that of its timestamps; rounding to whole frames a second stays below."""
LONGEST_STILL = 0.095
"""s for which one image may be shown while the vehicle moves: the images of a sample are 0.1 s apart."""

_SAME_IMAGE = 0.02  # of the usual change from image to image
_LEAST_CHANGE = 0.3  # grey levels, of most changes; below, images are too plain to tell
_SLOWEST = 2.0  # m/s at which images of a moving vehicle change
_LEAST_SEEN = 0.1  # share of a frame that was observed and not invented


def check_videos(store: ClipStore, clip_id: str, videos: ClipVideos) -> Iterator[Finding]:
    """Decode the video of every camera and hold it against timestamps, lens and motion."""
    motion = store.read_ego_motion(clip_id)
    for camera in store.info(clip_id).views:
        where = f"{store.root}: clip {clip_id}: {camera}"
        times_us = store.read_timestamps(clip_id, camera)
        lens = store.read_camera(clip_id, camera).camera
        video = videos.decode(camera)
        yield from check_decoded(video, times_us, (lens.width, lens.height), where)
        if video.problem is None and len(video.change) == len(times_us) - 1:
            yield check_repeated_images(video, times_us, motion, store.read_origin_runs(clip_id, camera), where)


def check_decoded(
    video: DecodedVideo, times_us: NDArray[np.int64], size: tuple[int, int], where: str
) -> Iterator[Finding]:
    """Frames, numbers, size and rate of a video, for timestamps (n,) and a lens of that width and height."""
    yield state("video decodes", where, video.problem is None, video.problem or "from the first frame to the last")
    count = len(times_us)
    detail = f"frames too many or too few: {len(video.numbers)} for {count} timestamps; is it another clip's video?"
    yield judge("frames for timestamps", where, float(abs(len(video.numbers) - count)), 0.0, detail)
    wrong = np.flatnonzero(video.numbers != np.arange(len(video.numbers)))
    at = f", first frame {wrong[0]}" if len(wrong) else ""
    detail = f"frames that readers take for others, because container times begin late or have gaps{at}"
    yield judge("container times", where, float(len(wrong)), 0.0, detail)
    shown = ", ".join(f"{width} x {height}" for width, height in sorted(video.sizes)) or "no frame"
    detail = f"frames of {shown} for a lens of {size[0]} x {size[1]} pixels; is it another camera's video?"
    yield state("frame size", where, video.sizes == {size}, detail)
    if video.rate == 0.0:
        yield not_compared("frame rate", where, "the video states no rate")
        return
    ratio = video.rate * float(np.median(np.diff(times_us))) * 1e-6
    factor = max(ratio, 1.0 / ratio)
    detail = f"times apart: the video states {video.rate:.4g} frames a second, timestamps {video.rate / ratio:.4g}"
    yield judge("frame rate", where, factor, RATE_FACTOR, detail)


def check_repeated_images(
    video: DecodedVideo, times_us: NDArray[np.int64], motion: EgoMotion, masks: OriginRuns | None, where: str
) -> Finding:
    """Whether one image is shown again while the vehicle moves; what is invented need not change."""
    check = "no image repeated"
    known_us = motion.trajectory.timestamps_us
    position = np.stack([np.interp(times_us, known_us, axis) for axis in motion.trajectory.positions.T], axis=-1)
    interval = np.diff(times_us) * 1e-6
    moves = np.linalg.norm(np.diff(position, axis=0), axis=1) >= _SLOWEST * interval
    if masks is not None:
        seen = seen_shares(masks) >= _LEAST_SEEN
        moves &= seen[1:] & seen[:-1]
    if not moves.any():
        return not_compared(check, where, f"the vehicle never moves at {_SLOWEST:g} m/s while anything is seen")
    usual = float(np.quantile(video.change[moves], 0.9))
    if usual < _LEAST_CHANGE:
        return not_compared(check, where, f"images change by {usual:.2g} grey levels; too plain, or all are the same")
    still = moves & (video.change <= _SAME_IMAGE * usual)
    longest, run, at = 0.0, 0.0, 0
    for frame, (same, seconds) in enumerate(zip(still.tolist(), interval.tolist(), strict=True)):
        run = run + seconds if same else 0.0
        if run > longest:
            longest, at = run, frame + 1
    return judge(check, where, longest, LONGEST_STILL, f"s that one image is shown, up to frame {at}, while driving")


def seen_shares(masks: OriginRuns) -> Array:
    """Share (n,) of each frame's pixels that a camera saw."""
    seen = np.isin(masks.values, [PixelOrigin.SAME_FRAME, PixelOrigin.OTHER_FRAME]) * masks.lengths
    totals = np.concatenate([[0], np.cumsum(seen)])
    return np.diff(totals[masks.edges]) / (masks.width * masks.height)
