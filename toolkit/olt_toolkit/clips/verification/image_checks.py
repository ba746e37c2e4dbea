"""Checks that look at what the images of a clip show."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.camera_checks import check_names, check_own_videos, check_tele
from olt_toolkit.clips.verification.clip_evidence import gather_evidence
from olt_toolkit.clips.verification.findings import Finding
from olt_toolkit.clips.verification.motion_checks import (
    check_frame_order,
    check_frame_times,
    check_mirrored,
    check_motion,
    check_this_clip,
)


def check_images(store: ClipStore, clip_id: str) -> Iterator[Finding]:
    """Hold the images of all cameras against each other and against the ego motion; decodes each video once.

    Raises:
        InputError: the clip's files are damaged.
    """
    clip = gather_evidence(store, clip_id)
    findings = [check_motion(clip), *check_names(clip), *check_own_videos(clip), *check_tele(clip)]
    for camera in clip.evidence:
        for check in (check_frame_order, check_frame_times, check_mirrored, check_this_clip):
            findings.append(check(clip, camera))
    for finding in findings:
        yield replace(finding, where=f"{store.root}: clip {clip_id}: {finding.where}")


IMAGE_CHECKS: tuple[Callable[[ClipStore, str], Iterable[Finding]], ...] = (check_images,)
