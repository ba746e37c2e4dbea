"""Whether the clocks of cameras and motion are one, and the times of a clip those that its tables promise."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.findings import Finding, Verdict, judge, state
from olt_toolkit.policy.window import Coverage, check_sample_window
from olt_toolkit.rigs.contracts import widest_contract

SHORTEST_FRAME, LONGEST_FRAME = 1 / 240, 1.0
"""s between frames: faster than any camera of a vehicle, slower than any that a policy can look through."""
SHORTEST_POSE, LONGEST_POSE = 5e-4, 1.0
"""s between poses: inertial units give at most 2,000 a second."""
LARGEST_GAP = 1.75
"""Times the usual interval: one frame that is missing makes it 2."""
CLOCK_OFFSET = 0.05
"""s by which spans of times may differ: half a step of the policy, whose images are to be of one moment."""
_CLOCK_FRAMES = 0.75  # and this many frames, where they are farther apart
_SHORTEST_GAP = 0.15  # seconds; a shorter one shows no image to the policy twice


def check_times(store: ClipStore, clip_id: str) -> Iterator[Finding]:
    """Units, gaps, offsets and drifts of all clocks, and sample times that the clip covers."""
    info, where = store.info(clip_id), f"{store.root}: clip {clip_id}"
    times_us = {camera: store.read_timestamps(clip_id, camera) for camera in info.views}
    ego_us = store.read_ego_motion(clip_id).trajectory.timestamps_us
    yield _check_unit("time unit of poses", f"{where}: egomotion", ego_us, SHORTEST_POSE, LONGEST_POSE)
    for camera, of_camera in times_us.items():
        place = f"{where}: {camera}"
        yield _check_unit("time unit of frames", place, of_camera, SHORTEST_FRAME, LONGEST_FRAME)
        yield check_gaps(of_camera, place)
        yield _check_inside(of_camera, ego_us, place)
    yield from check_common_clock(times_us, where)
    yield judge(
        "duration",
        where,
        abs(int(ego_us[-1]) - info.duration_us) * 1e-6,
        0.0,
        "s between the last pose and the duration in the clip table; build the clip again",
    )
    yield _check_samples(store, clip_id, times_us, ego_us)


def check_gaps(times_us: NDArray[np.int64], where: str) -> Finding:
    """Whether frames (n,) are missing: gaps that are long against the usual interval, and long for the policy."""
    intervals = np.diff(times_us) * 1e-6
    usual = max(float(np.quantile(intervals, 0.95)), _SHORTEST_GAP / LARGEST_GAP)
    frame = int(np.argmax(intervals))
    measured = float(intervals[frame]) / usual
    detail = f"times the usual interval, {usual:.3g} s, after frame {frame}; frames are missing there"
    return judge("no frame missing", where, measured, LARGEST_GAP, detail)


def check_common_clock(times_us: dict[str, NDArray[np.int64]], where: str) -> Iterator[Finding]:
    """Whether cameras begin and end together: a shifted clock moves both ends of one, a drift one end."""
    if len(times_us) < 2:
        why = "the clip has one camera; its clock can be held against images alone"
        yield Finding("cameras on one clock", where, Verdict.NOT_COMPARED, why)
        return
    ends = np.array([(times[0], times[-1]) for times in times_us.values()]) * 1e-6
    off = ends - np.median(ends, axis=0)
    for (camera, times), (begin, end) in zip(times_us.items(), off.tolist(), strict=True):
        limit = max(CLOCK_OFFSET, _CLOCK_FRAMES * float(np.median(np.diff(times))) * 1e-6)
        detail = f"s off the other cameras: it begins {begin:+.3f} s and ends {end:+.3f} s from them"
        yield judge("cameras on one clock", f"{where}: {camera}", max(abs(begin), abs(end)), limit, detail)


def _check_unit(check: str, where: str, times_us: NDArray[np.int64], shortest: float, longest: float) -> Finding:
    interval = float(np.median(np.diff(times_us))) * 1e-6
    detail = f"{interval:.3g} s from one time to the next, of {shortest:.3g} to {longest:.3g}; times are microseconds"
    return state(check, where, shortest <= interval <= longest, detail)


def _check_inside(times_us: NDArray[np.int64], ego_us: NDArray[np.int64], where: str) -> Finding:
    beyond = max(int(ego_us[0]) - int(times_us[0]), int(times_us[-1]) - int(ego_us[-1]), 0) * 1e-6
    detail = "s of frames before the first pose or after the last; is one clock shifted?"
    return judge("frames within the motion", where, beyond, CLOCK_OFFSET, detail)


def _check_samples(
    store: ClipStore, clip_id: str, times_us: dict[str, NDArray[np.int64]], ego_us: NDArray[np.int64]
) -> Finding:
    info, where = store.info(clip_id), f"{store.root}: clip {clip_id}"
    spans = {camera: (int(of_camera[0]), int(of_camera[-1])) for camera, of_camera in times_us.items()}
    coverage = Coverage((int(ego_us[0]), int(ego_us[-1])), spans)
    t0s_us = info.sample_t0_us
    if list(t0s_us) != sorted(set(t0s_us)):
        return state("sample times", where, False, "they are not in order, or one is there twice; build it again")
    if info.action_errors is not None and len(info.action_errors) != len(t0s_us):
        detail = f"{len(info.action_errors)} action errors for {len(t0s_us)} sample times; build it again"
        return state("sample times", where, False, detail)
    for t0_us in t0s_us:
        try:
            check_sample_window(t0_us, coverage, where, widest_contract(info.views))
        except InputError as error:
            return state("sample times", where, False, str(error))
    return state("sample times", where, True, f"{len(t0s_us)}, all of which the clip covers")
