"""Windows of a drive, and the policy samples that each would give once it is built.

The paper cuts a segment into windows of 41 front images that do not touch: images 0 to 40, then 42 to 82.
"""

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np

from olt_datasets.tables.choices import PAPER_FRAMES, PAPER_STRIDE, SampleChoice
from olt_generator.errors import InputError
from olt_toolkit.clips.clip import ClipInfo, ClipKind, ClipOrigin
from olt_toolkit.clips.identity import clip_id_of
from olt_toolkit.policy.sample import KEYFRAME_US
from olt_toolkit.policy.window import FUTURE_OFFSETS_US, HISTORY_OFFSETS_US, STEP_US, Coverage, Span, sample_times
from olt_toolkit.recordings.drives import Drive
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT, CameraContract
from olt_toolkit.runtime.version import code_version


@dataclass(frozen=True)
class Cutting:
    """How drives are cut.

    Attributes:
        frames: front images in a window.
        stride: images from the start of a window to the start of the next.
        seconds: duration of windows that follow one another, in place of `frames` and `stride`; None for those.
        whole: whether each drive is one window, in place of all of these.
        samples: every t0 on the 0.1 s grid, the one nearest to 5.1 s, or the events that the data set marks.
        contract: the cameras of which a drive must have true images for its clips to be of kind GT.

    Raises:
        InputError: a window would be empty, or would not move on.
    """

    frames: int = PAPER_FRAMES
    stride: int = PAPER_STRIDE
    seconds: float | None = None
    whole: bool = False
    samples: SampleChoice = SampleChoice.EVERY
    contract: CameraContract = DEFAULT_CONTRACT

    def __post_init__(self) -> None:
        if self.frames < 2 or self.stride < 1:
            raise InputError(
                f"windows of {self.frames} frames, {self.stride} apart: give at least 2 frames and a stride of 1"
            )
        if self.seconds is not None and not self.seconds > 0.0:
            raise InputError(f"windows of {self.seconds:g} s: give a duration above 0")


def cut_drive(drive: Drive, cutting: Cutting, licence: str | None, name: str | None = None) -> list[ClipInfo]:
    """The clips that the windows of a drive would be, as rows of a clip table.

    Such a clip is not built yet. It is of kind GT where the data set has true images for all cameras of the contract,
    and front only elsewhere; its sample times are those that it will give once its other views are made. Times of its
    front images are counted from the start of the drive. Its split is that of the data set, None where that has none.
    The same drive and cutting give the same ids everywhere, and a GT clip keeps its id when it is built. `name` is what
    people call the drive; its key by default.
    """
    told = asdict(drive)
    del told["key"]  # where the drive lies changes nothing of it
    front_us = told.pop("front_us").astype("<i8").tobytes()
    description = _hash_of(json.dumps(told, sort_keys=True).encode() + front_us)
    kind: ClipKind = "front_only" if cutting.contract.lacking(drive.true_views) else "GT"
    called = name or drive.key.replace("/", "-")
    clips = []
    for start, end in find_windows(drive, cutting):
        times, reason = find_samples(drive, (start, end), cutting.samples)
        clips.append(
            ClipInfo(
                clip_id=clip_id_of(drive.scene_id, drive.take, (start, end), kind),
                name=f"{called}_{start // 1000:06d}_{end // 1000:06d}",
                scene_id=drive.scene_id,
                source=drive.source,
                origin=ClipOrigin(drive.key, start, end, drive.country, licence),
                kind=kind,
                category=drive.category,
                factors=drive.factors,
                split=drive.split,
                duration_us=(end if drive.ego_span_us is None else drive.ego_span_us[1]) - start,
                sample_t0_us=times,
                no_sample_reason=reason,
                created_with=code_version(),
                checksum=_hash_of(f"{description} {(start, end)} {times} {licence}".encode()),
                fingerprint=None,
                views={},
            )
        )
    return clips


def find_windows(drive: Drive, cutting: Cutting) -> Iterator[Span]:
    """Times of the first and the last front image of each window; a window that the drive does not fill is left out."""
    times = drive.front_us
    if cutting.whole:
        if len(times) > 1:
            yield int(times[0]), int(times[-1])
    elif cutting.seconds is None:
        starts = np.arange(0, len(times) - cutting.frames + 1, cutting.stride)
        yield from zip(times[starts].tolist(), times[starts + cutting.frames - 1].tolist(), strict=True)
    elif len(times) > 1:
        duration_us, spacing = round(1e6 * cutting.seconds), int(np.median(np.diff(times)))
        count = int(times[-1] + spacing) // duration_us
        edges = np.searchsorted(times, duration_us * np.arange(count + 1))
        for first, following in pairwise(edges.tolist()):
            if following - first > 1:
                yield int(times[first]), int(times[following - 1])


def find_samples(drive: Drive, window: Span, choice: SampleChoice) -> tuple[tuple[int, ...], str | None]:
    """Times t0 since the start of a window at which it gives a sample, and why there are none where there are none.

    Ego motion that the data set measured counts beyond the window; motion that is still to be recovered from the
    images ends with them.
    """
    start, end = window
    ego = window if drive.ego_span_us is None else drive.ego_span_us
    coverage = Coverage((ego[0] - start, ego[1] - start), dict.fromkeys(DEFAULT_CONTRACT.cameras, (0, end - start)))
    times, reason = sample_times(coverage)
    if times and drive.usable_us is not None:
        first, last = drive.usable_us
        earliest, latest = first - start - int(HISTORY_OFFSETS_US[0]), last - start - int(FUTURE_OFFSETS_US[-1])
        times = tuple(time for time in times if earliest <= time <= latest)
        # The stretch is told in clip time.
        told = f"{(first - start) / 1e6:.6g} to {(last - start) / 1e6:.6g} s"
        reason = None if times else f"only {told} of it may be imitated; a sample needs 7.9 s of that"
    if times and choice is SampleChoice.KEYFRAME:
        times = (min(times, key=lambda time: abs(time - KEYFRAME_US)),)
    if times and choice is SampleChoice.EVENTS:
        # The times on the grid that are nearest to an event.
        events = [time - start for time in drive.event_t0s_us]
        nearest = [(min(times, key=lambda time, event=event: abs(time - event)), event) for event in events]
        times = tuple(sorted({time for time, event in nearest if abs(time - event) <= STEP_US // 2}))
        if not times:
            reason = f"the data set marks {len(events)} moments of the drive, none where the clip gives a sample"
    return times, reason


def _hash_of(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()
