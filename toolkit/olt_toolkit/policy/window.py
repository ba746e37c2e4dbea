"""Which times of a clip give a policy sample.

A sample at t0 takes ego poses from t0 - 1.5 s to t0 + 6.4 s and four images up to t0 of each camera of the policy's
contract. The public loader refuses t0 up to 1.6 s although the oldest pose is 1.5 s old
(docs/formats/physicalai_av.md); the same rule holds here, so that both accept the same samples.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_toolkit.policy.contract import FUTURE_STEPS, HISTORY_STEPS, IMAGE_FRAMES, STEP_US
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT, CameraContract

Span = tuple[int, int]
"""First and last time in microseconds."""

HISTORY_OFFSETS_US: NDArray[np.int64] = STEP_US * np.arange(1 - HISTORY_STEPS, 1, dtype=np.int64)
FUTURE_OFFSETS_US: NDArray[np.int64] = STEP_US * np.arange(1, FUTURE_STEPS + 1, dtype=np.int64)
IMAGE_OFFSETS_US: NDArray[np.int64] = STEP_US * np.arange(1 - IMAGE_FRAMES, 1, dtype=np.int64)
LONGEST_REFUSED_T0_US = HISTORY_STEPS * STEP_US


@dataclass(frozen=True)
class Coverage:
    """The spans of a clip's ego motion and of its cameras by name."""

    ego: Span
    cameras: dict[str, Span]


def sample_times(coverage: Coverage, contract: CameraContract = DEFAULT_CONTRACT) -> tuple[tuple[int, ...], str | None]:
    """Times t0 (multiples of 0.1 s) that give a sample, and why there are none where there are none."""
    if contract.lacking(coverage.cameras):
        return (), _missing_cameras(coverage, contract)
    spans = [coverage.cameras[name] for name in contract.cameras]
    earliest = max(
        LONGEST_REFUSED_T0_US + 1,
        coverage.ego[0] - int(HISTORY_OFFSETS_US[0]),
        max(first for first, _ in spans) - int(IMAGE_OFFSETS_US[0]),
    )
    latest = min(coverage.ego[1] - int(FUTURE_OFFSETS_US[-1]), min(last for _, last in spans))
    times = tuple(range(-(-earliest // STEP_US) * STEP_US, latest + 1, STEP_US))
    if times:
        return times, None
    return (), (
        f"t0 must be at least {_seconds(earliest)} (history and images) and at most {_seconds(latest)} "
        f"(6.4 s of future); ego motion covers {_span(coverage.ego)}"
    )


def newest_frames(timestamps_us: NDArray[np.int64], times_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices (m,) of the newest of the frames at times (n,) at or before each time; -1 before the first."""
    return np.searchsorted(timestamps_us, times_us, side="right") - 1


def grid_frame_indices(timestamps_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices (m,) of the frames that samples with t0 on the 0.1 s grid take, out of frames at these times (n,).

    Those are the newest frames at each time of the grid. The first and the last frame are kept, so that the coverage
    stays the same; every other frame can be left out without changing any such sample.
    """
    first, last = int(timestamps_us[0]), int(timestamps_us[-1])
    grid = np.arange(-(-first // STEP_US), last // STEP_US + 1) * STEP_US
    return np.unique(np.concatenate([[0], newest_frames(timestamps_us, grid), [len(timestamps_us) - 1]]))


def sampled_frame_indices(timestamps_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those (m,) of the `grid_frame_indices` that a recording's own samples take, out of frames at these times (n,).

    The first frames are too early for a sample, the last lack a future. All `grid_frame_indices` where the recording is
    too short for a sample.
    """
    on_grid, span = grid_frame_indices(timestamps_us), (int(timestamps_us[0]), int(timestamps_us[-1]))
    times, _ = sample_times(Coverage(span, dict.fromkeys(DEFAULT_CONTRACT.cameras, span)))
    if not times:
        return on_grid
    first = newest_frames(timestamps_us, times[0] + IMAGE_OFFSETS_US[:1])
    # Cameras must cover the last t0, so a frame at or after it is kept.
    last = np.searchsorted(timestamps_us, times[-1])
    return np.union1d(on_grid[(on_grid >= first) & (on_grid <= last)], [last])


def frames_per_step(frame_rate: float) -> int:
    """How many frames follow each other in 0.1 s; 1 where that is no whole number."""
    frames = frame_rate * STEP_US * 1e-6
    return round(frames) if frames >= 1 and abs(frames - round(frames)) < 1e-6 else 1


def check_sample_window(
    t0_us: int, coverage: Coverage, where: str, contract: CameraContract = DEFAULT_CONTRACT
) -> None:
    """Check that all is there that a sample at `t0_us` needs; an `InputError` names where, what and the times."""
    if t0_us <= LONGEST_REFUSED_T0_US:
        raise InputError(f"{where}: t0 = {_seconds(t0_us)} is not after 1.6 s; choose one of the clip's sample times")
    _check_span(f"{where}: ego motion", coverage.ego, t0_us, (HISTORY_OFFSETS_US[0], FUTURE_OFFSETS_US[-1]))
    if contract.lacking(coverage.cameras):
        raise InputError(f"{where}: {_missing_cameras(coverage, contract)}")
    for camera in contract.cameras:
        _check_span(f"{where}: {camera}", coverage.cameras[camera], t0_us, (IMAGE_OFFSETS_US[0], IMAGE_OFFSETS_US[-1]))


def _check_span(what: str, span: Span, t0_us: int, offsets: tuple[np.int64, np.int64]) -> None:
    needed = (t0_us + int(offsets[0]), t0_us + int(offsets[1]))
    if needed[0] < span[0] or needed[1] > span[1]:
        raise InputError(
            f"{what} covers {_span(span)}, but t0 = {_seconds(t0_us)} needs {_span(needed)}; "
            "choose one of the clip's sample times"
        )


def _missing_cameras(coverage: Coverage, contract: CameraContract) -> str:
    missing, needed = (", ".join(names) for names in (contract.lacking(coverage.cameras), contract.cameras))
    return f"no {missing}; a policy sample of {contract.name} needs all of {needed}"


def _span(span: Span) -> str:
    return f"{_seconds(span[0])} to {_seconds(span[1])}"


def _seconds(time_us: int) -> str:
    return f"{time_us / 1e6:.6g} s"
