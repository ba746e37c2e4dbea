"""What the errors of many clips say together: by kind as a table, as a plot, and as a sheet of their frames."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.benchmarks.motion_errors import ClipErrors, MeasuredClip
from olt_generator.errors import InputError
from olt_generator.files import write_whole

# Errors beyond so many standard deviations must have been marked.
LIMIT = 4.0
ALL = "all"
_DRAWN_LIMIT = 8.0


def summarize(clips: Sequence[ClipErrors]) -> list[dict[str, Any]]:
    """A row by kind, in the order in which they come, and one of all; None is not measured."""
    kinds = list(dict.fromkeys(clip.kind for clip in clips))
    rows = [_summarize_kind(kind, [clip for clip in clips if clip.kind == kind]) for kind in kinds]
    return rows if len(kinds) < 2 else [*rows, _summarize_kind(ALL, clips)]


def _summarize_kind(kind: str, clips: Sequence[ClipErrors]) -> dict[str, Any]:
    given = [clip for clip in clips if clip.refused is None]
    trusted = [clip for clip in given if not clip.marked]
    judged = [clip for clip in given if clip.worst_z is not None]
    worst = max(judged, key=lambda clip: clip.worst_z or 0.0, default=None)
    ates = [clip.ate_m for clip in given if clip.ate_m is not None]
    return {
        "kind": kind,
        "clips": len(clips),
        "marked": len(given) - len(trusted),
        "refused": len(clips) - len(given),
        "scale_z_rms": _root_mean_square(clip.scale_z for clip in trusted),
        "scale_z_rms_with_marked": _root_mean_square(clip.scale_z for clip in given),
        "ate_z_rms": _root_mean_square(clip.ate_z for clip in trusted),
        "ate_m_median": float(np.median(ates)) if ates else None,
        "ate_m_worst": max(ates, default=None),
        "backwards_unmarked": sum(clip.backwards for clip in trusted),
        "beyond_limit_unmarked": sum((clip.worst_z or 0.0) > LIMIT for clip in trusted),
        "worst_clip": worst.name if worst else None,
        "worst_clip_z": worst.worst_z if worst and not worst.backwards else None,
        "worst_clip_backwards": bool(worst and worst.backwards),
        "ms_per_frame": 1e3 * float(np.median([clip.seconds_per_frame for clip in clips])),
    }


def count_reasons(clips: Iterable[ClipErrors]) -> dict[str, dict[str, int]]:
    """How often clips were refused, and marked, for what reason; numbers in a reason are left out."""
    refused, marked = Counter[str](), Counter[str]()
    for clip in clips:
        if clip.refused is not None:
            refused[_without_numbers(clip.refused)] += 1
        for doubt in {doubt.partition(":")[0] for doubt in clip.doubts}:
            marked[doubt] += 1
    return {"refused": dict(refused.most_common()), "marked": dict(marked.most_common())}


def draw_scale_errors(path: Path, clips: Sequence[ClipErrors]) -> None:
    """Draw z of the scale against kind into a PNG: a dot a clip, hollow if marked; refused ones on a line below.

    Errors beyond 8 standard deviations, and motion that goes backwards, stand at the edge as triangles.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    kinds = list(dict.fromkeys(clip.kind for clip in clips))
    figure, axes = pyplot.subplots(figsize=(max(6.0, 0.75 * len(kinds) + 2.0), 5.5), layout="constrained")
    axes.axhspan(-1.0, 1.0, color="0.92")
    for level in (-LIMIT, LIMIT):
        axes.axhline(level, color="tab:red", lw=0.8)
    bottom = -_DRAWN_LIMIT - 1.5
    for column, kind in enumerate(kinds):
        of_kind = [clip for clip in clips if clip.kind == kind]
        for x, clip in zip(column + np.linspace(-0.3, 0.3, len(of_kind)), of_kind, strict=True):
            color = f"C{column % 10}"
            if clip.refused is not None:
                axes.plot(x, bottom, "x", color="0.4", ms=5)
                continue
            z = -np.inf if clip.backwards else clip.scale_z
            if z is not None:
                marker = "o" if abs(z) <= _DRAWN_LIMIT else ("^" if z > 0 else "v")
                height = float(np.clip(z, -_DRAWN_LIMIT, _DRAWN_LIMIT))
                axes.plot(x, height, marker, color=color, mfc="none" if clip.marked else color, ms=5)
    axes.set_xticks(range(len(kinds)), kinds, rotation=40, ha="right")
    axes.set_ylim(bottom - 0.8, _DRAWN_LIMIT + 0.8)
    axes.set_yticks([bottom, *range(-8, 9, 2)], ["refused", *map(str, range(-8, 9, 2))])
    axes.set(ylabel="scale error / stated sigma", title="Motion of hard clips (hollow: marked as doubtful)")
    axes.grid(True, axis="y", alpha=0.3)
    with write_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})
    pyplot.close(figure)


def write_sheet(path: Path, clips: Sequence[MeasuredClip], columns: int = 4) -> None:
    """A contact sheet (PNG): a row a clip with its first, middle and last frame, `columns` clips side by side."""
    rows = [np.vstack([_caption(clip), np.hstack(list(clip.thumbnails))]) for clip in clips]
    rows += [np.zeros_like(rows[0])] * (-len(rows) % columns)
    sheet = np.vstack([np.hstack(rows[first : first + columns]) for first in range(0, len(rows), columns)])
    coded, data = cv2.imencode(".png", sheet[..., ::-1])
    if not coded:
        raise InputError(f"{path}: a sheet of {sheet.shape[1]} x {sheet.shape[0]} pixels cannot be coded; ask for less")
    with write_whole(path) as temporary:
        temporary.write_bytes(data.tobytes())


def _caption(clip: MeasuredClip) -> NDArray[np.uint8]:
    """A strip above the frames of a clip with its name and how well its motion was found."""
    strip = np.zeros((16, clip.thumbnails.shape[0] * clip.thumbnails.shape[2], 3), dtype=np.uint8)
    text = f"{clip.errors.name}: {_verdict(clip.errors)}"
    cv2.putText(strip, text, (4, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1, cv2.LINE_AA)
    return strip


def _verdict(clip: ClipErrors) -> str:
    if clip.refused is not None:
        return "refused"
    z = "backwards" if clip.backwards else ("not measured" if clip.scale_z is None else f"z {clip.scale_z:+.1f}")
    ate = "" if clip.ate_m is None else f", ATE {clip.ate_m:.2f} m"
    return f"{'marked, ' if clip.marked else ''}{z}{ate}"


def _root_mean_square(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None


def _without_numbers(text: str) -> str:
    """The first clause of a refusal, with a # for every number."""
    clause = text.split(";")[0]
    return " ".join("#" if any(letter.isdigit() for letter in word) else word for word in clause.split())
