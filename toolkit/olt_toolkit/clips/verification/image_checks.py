"""Checks that look at what the images of a clip show."""

from collections.abc import Iterator
from dataclasses import replace

from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.camera_checks import check_names, check_own_videos, check_tele
from olt_toolkit.clips.verification.clip_evidence import ClipEvidence, gather_evidence
from olt_toolkit.clips.verification.decoded_videos import ClipVideos
from olt_toolkit.clips.verification.findings import Finding, not_compared
from olt_toolkit.clips.verification.motion_checks import (
    check_frame_order,
    check_frame_times,
    check_mirrored,
    check_motion,
    check_this_clip,
)
from olt_toolkit.clips.verification.neighbour_checks import check_neighbours, with_neighbours

# In narrower images, pixels, too little can be followed.
LEAST_WIDTH = 160


def check_images(store: ClipStore, clip_id: str, videos: ClipVideos) -> Iterator[Finding]:
    """Hold the images of all cameras against each other and against the ego motion.

    Raises:
        InputError: the clip's files are damaged.
    """
    where = f"{store.root}: clip {clip_id}"
    widths = {camera: store.read_camera(clip_id, camera).camera.width for camera in store.info(clip_id).views}
    small = [camera for camera, width in widths.items() if width < LEAST_WIDTH]
    for camera in small:
        why = f"images of {widths[camera]} pixels across are too small: at least {LEAST_WIDTH} can be looked at"
        yield not_compared("images against motion", f"{where}: {camera}", why)
    if len(small) == len(widths):
        return
    clip = gather_evidence(store, clip_id, [camera for camera in widths if camera not in small], videos)
    yield from (replace(finding, where=f"{where}: {finding.where}") for finding in _check_all(clip))


def _check_all(clip: ClipEvidence) -> Iterator[Finding]:
    neighbours = list(check_neighbours(clip))
    yield from neighbours
    clip = with_neighbours(clip, neighbours)
    yield from check_motion(clip)
    yield from check_names(clip)
    yield from check_own_videos(clip)
    yield from check_tele(clip)
    for camera in clip.evidence:
        for check in (check_frame_order, check_frame_times, check_mirrored, check_this_clip):
            yield check(clip, camera)
