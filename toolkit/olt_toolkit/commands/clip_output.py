"""What `olt clip` prints for people."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from olt_generator.omissions import Omission, word_omission
from olt_toolkit.clips.build_job import BuildResult
from olt_toolkit.policy.action_space import ROUND_TRIP_TOLERANCE
from olt_toolkit.runtime.console import print_line, print_table

# Label, and where the number is found in the pose errors.
_POSE_ROWS = (
    ("ATE (m)", ("metric", "ate_m")),
    ("rotation to first pose (deg)", ("metric", "rotation_to_first_deg")),
    ("rotation by step (deg)", ("metric", "step_rotation_deg")),
    ("translation by step (%)", ("metric", "step_translation_percent")),
    ("drift at the end (%)", ("metric", "drift_percent")),
    ("ATE after Sim(3) alignment (m)", ("sim3", "ate_m")),
    ("scale of the Sim(3) alignment", ("sim3", "scale")),
)

_SHARES = ("observed", "at other times", "invented", "not seen")


def print_build(summary: dict[str, Any]) -> None:
    """Print what building one clip gave."""
    clip, trajectory = summary["clip"], summary["trajectory"]
    print_line(f"clip {clip['name']} ({clip['kind']}) {clip['clip_id']}")
    print_line(
        f"trajectory: {trajectory['length']:.1f} m in {trajectory['duration']:.1f} s, speed "
        f"{trajectory['lowest_speed']:.1f} to {trajectory['highest_speed']:.1f} m/s"
    )
    print_line(f"poses: {summary['sources']['poses']}, depth: {summary['sources']['depth']}")
    rows: list[tuple[object, ...]] = [
        (label, find_number(summary, "pose_errors_before_smoothing", *keys), find_number(summary, "pose_errors", *keys))
        for label, keys in _POSE_ROWS
    ]
    jerk = (find_number(summary, part, "jerk_rms_m_s3") for part in ("smoothness_before_smoothing", "smoothness"))
    rows += [
        ("jerk, RMS (m/s3)", *jerk),
        ("scale, error relative", "", summary["scale_error"]),
        ("scale, 1 sigma relative", "", _known(summary["scale_sigma"])),
        ("position, 1 sigma RMS (m)", "", _known(summary["ate_sigma_m"])),
        ("distance, median relative error", "", summary["distance_median_relative_error"]),
    ]
    print_table("Errors against the reference, and jerk", ["quantity", "before smoothing", "after"], rows)
    if summary["scale_sigma_parts"] is not None:
        print_line(f"scale: {word_scale(summary['scale_sigma_parts'])}")
    if summary["given_motion"] is None:
        _print_label_noise(summary["label_noise"])
    else:
        _print_given_motion(summary["given_motion"])
    _print_action_errors(summary)
    for doubt in summary["doubts"]:
        print_line(f"in doubt: {doubt['what']}: {doubt['why']}")
    rows = []
    for name, view in clip["views"].items():
        errors = (
            summary["view_errors"].get(name, {})
            if view["kind"] in ("warped", "generated")
            else {"psnr": "", "psnr_observed": ""}
        )
        rows.append((name, view["kind"], *_share_cells(view), errors.get("psnr"), errors.get("psnr_observed")))
    print_table("Views", ["view", "kind", *_SHARES, "PSNR dB", "PSNR dB, observed"], rows)
    print_table("Run time", ["step", "seconds"], list((summary["seconds"] | summary["store_seconds"]).items()))
    _print_notes(summary)
    print_line(_verification_line(summary))
    print_line(_sample_line(clip))
    _print_pictures(summary)


def _verification_line(summary: dict[str, Any]) -> str:
    verified = summary["verification"]
    if verified is None:
        return "not verified (--no-verify)"
    return f"verified: {verified['passed']} checks passed, {verified['not_compared']} not compared"


def print_results(results: Sequence[BuildResult], store: Path) -> None:
    """Print what became of each job, failures last; of clips that are built now length, label noise, time, samples."""
    rows = []
    for result in results:
        summary = result.summary
        cells: tuple[object, ...] = ("", "", "", "", "", "", "")
        if summary is not None:
            noise = _word_noise(summary["clip"]["acceleration_noise"], summary["clip"]["acceleration_noise_basis"])
            seconds = sum((summary["seconds"] | summary["store_seconds"]).values())
            doubts = ", ".join(summary["clip"]["doubts"]) or "nothing"
            sigma = "given" if summary["scale_sigma_parts"] is None else _known(summary["scale_sigma"])
            samples = len(summary["clip"]["sample_t0_us"])
            beyond = find_number(summary, "action_errors", "beyond_tolerance")
            cells = summary["trajectory"]["length"], sigma, noise, doubts, seconds, samples, beyond
        if result.state != "failed":
            rows.append((result.path.name, result.state, result.clip_id, *cells))
    columns = [
        "recording",
        "state",
        "clip",
        "length m",
        "scale 1 sigma",
        "label noise",
        "in doubt",
        "seconds",
        "samples",
        f"action error > {ROUND_TRIP_TOLERANCE:g} m",
    ]
    print_table(f"Clips in {store}", columns, rows)
    lines = Counter(_verification_line(each.summary) for each in results if each.summary is not None)
    for line, count in lines.items():
        print_line(f"{count} clips: {line}")
    for result in results:
        if result.message is not None:
            print_line(f"{'failed' if result.state == 'failed' else 'left out'}: {result.path.name}: {result.message}")


def print_plan(plan: dict[str, Any], folder: Path) -> None:
    """Print which views were made, how, and which were left out."""
    rows = [
        (name, view["method"], *_share_cells(view), Path(view["file"]).name) for name, view in plan["views"].items()
    ]
    print_table(f"Views of {plan['recording']}", ["view", "method", *_SHARES, "file"], rows)
    print_line(f"made in this order: {', '.join(plan['order'])}")
    _print_notes(plan)
    print_line(f"files: {folder}")


def print_clips(summary: dict[str, Any]) -> None:
    """Print the clip table of a store."""
    rows = [
        (
            *(clip[key] for key in ("clip_id", "name", "kind", "category", "split")),
            _word_doubts(clip),
            _sample_line(clip),
        )
        for clip in summary["clips"]
    ]
    columns = ["clip", "name", "kind", "category", "split", "in doubt", "samples"]
    print_table(f"Clips in {summary['store']}", columns, rows)


def print_clip(summary: dict[str, Any]) -> None:
    """Print one clip as it is stored."""
    clip, trajectory = summary["clip"], summary["trajectory"]
    print_line(f"clip {clip['name']} ({clip['kind']}, {clip['category']}, {clip['split']}) {clip['clip_id']}")
    print_line(f"trajectory: {trajectory['length']:.1f} m in {trajectory['duration']:.1f} s")
    sigma = clip["scale_sigma"]
    given = "not known, or the motion was given"
    print_line(f"scale, 1 sigma: {given if sigma is None else f'{100 * sigma:.1f} %'}")
    noise = _word_noise(clip["acceleration_noise"], clip["acceleration_noise_basis"])
    print_line(f"noise of acceleration labels: {noise}")
    print_line(f"action errors: {word_action_errors(summary['action_errors'])}")
    print_line(f"in doubt: {_word_doubts(clip)}")
    print_line(_sample_line(clip))
    print_line(f"cameras of: {', '.join(clip['contracts']) or 'no camera contract'}")
    rows = [
        (
            name,
            "x".join(str(side) for side in camera["size"]),
            camera["frames"],
            f"{camera['first_us'] / 1e6:.2f} to {camera['last_us'] / 1e6:.2f} s",
        )
        for name, camera in summary["cameras"].items()
    ]
    print_table("Cameras", ["camera", "size", "frames", "times"], rows)
    rows = [
        (
            name,
            view["kind"],
            f"{view['engine']} {view['version']}",
            "none" if view["seed"] is None else view["seed"],
            *_share_cells(view),
            summary["cameras"][name]["frames_not_seen"],
        )
        for name, view in clip["views"].items()
    ]
    columns = ["camera", "kind", "made by", "seed", *_SHARES, "images not seen at all"]
    print_table("Where the pixels came from", columns, rows)
    _print_pictures(summary)


def print_scores(summary: dict[str, Any]) -> None:
    """Print the scores of one clip."""
    consistency, reference = summary["geokpm"], summary["reference"]
    width, height = consistency["size"]
    rows = [(f"{pair['views'][0]} - {pair['views'][1]}", *_consistency_cells(pair)) for pair in consistency["pairs"]]
    print_table(
        f"GeoKPM with {consistency['matcher']}, {width} x {height} pixels, Sampson error below "
        f"{consistency['max_sampson_error_px']:g} px",
        ["views", "GeoKPM %", "moments", "without a match", "matches", "valid"],
        [*rows, ("all", *_consistency_cells(consistency))],
    )
    print_line("moments without a match have no share of valid ones and are not in the mean")
    _print_coherence(summary["coherence"])
    if reference is None:
        return
    rows = [
        (
            name,
            f"{view['size'][0]} x {view['size'][1]}",
            view["frames"],
            "identical" if view["psnr"] is None else view["psnr"],
            view["ssim"],
            view["lpips"],
        )
        for name, view in reference["views"].items()
    ]
    print_table(f"Against clip {reference['clip_id']}", ["view", "size", "frames", "PSNR dB", "SSIM", "LPIPS"], rows)
    print_line(f"LPIPS: {reference['lpips'] or 'not measured; give --lpips-weights'}")


def _print_coherence(views: dict[str, dict[str, Any]]) -> None:
    names = ("specks", "blur", "flicker", "agreement", "gap")
    rows = [
        (
            name,
            view["percent"],
            *("not measured" if (value := view["penalties"][each]) is None else value for each in names),
        )
        for name, view in views.items()
    ]
    print_table("Coherence with the front view", ["view", "coherence %", *names], rows)
    print_line(
        "penalties are in powers of two; agreement and gap are not measured where the front camera does not look"
    )


def word_scale(parts: dict[str, Any]) -> str:
    """How well a metric scale is known: its standard deviation, and that of each part with where it comes from."""
    total = "not known" if parts["total"] is None else f"1 sigma {100 * parts['total']:.2f} %"
    worded = [
        f"{name} " + ("not known" if part["relative"] is None else f"{100 * part['relative']:.2f} % ({part['origin']})")
        for name, part in (
            ("road", parts["road"]),
            ("height", parts["height"]),
            ("focal length", parts["focal_length"]),
        )
    ]
    return f"{total}; {', '.join(worded)}"


def find_number(numbers: Mapping[str, Any], *keys: str) -> Any:
    """A number in nested mappings; None where a level of them is None."""
    found: Any = numbers
    for key in keys:
        found = None if found is None else found[key]
    return found


def _known(value: float | None) -> float | str:
    return "not known" if value is None else value


def _word_doubts(clip: dict[str, Any]) -> str:
    if clip["doubts"] is None:
        return "not looked at"
    return ", ".join(clip["doubts"]) or "nothing"


def _share_cells(view: dict[str, Any]) -> tuple[str, ...]:
    """Which shares of a view's pixels were observed, at other times than their image's, invented, and not seen."""
    shares = (view[key] for key in ("observed_share", "other_times_share", "invented_share", "unseen_share"))
    return tuple(f"{100 * share:.1f} %" for share in shares)


def _consistency_cells(found: dict[str, Any]) -> tuple[object, ...]:
    return tuple(found[key] for key in ("percent", "moments", "moments_without_match", "matches", "valid"))


def _print_label_noise(budget: dict[str, Any] | None) -> None:
    if budget is None:
        print_line("label noise: not measured; it needs a motion that is not the reference, over at least 7.9 s")
        return
    columns = {
        "before smoothing": "raw",
        "after": "actual",
        "after, expected": "expected",
        "by the smoother": "smoother",
        "by the estimator": "estimator",
        "by the scale": "scale",
        "taken out by smoothing": "taken_out",
    }
    rows = [
        (f"{label} ({unit})", *(_known(find_number(budget, part, label)) for part in columns.values()))
        for label, unit in (("acceleration", "m/s2"), ("curvature", "1/m"))
    ]
    title = f"Noise of the policy's labels, RMS over {budget['samples']} samples"
    print_table(title, ["label", *columns], rows)


def _print_given_motion(given: dict[str, Any]) -> None:
    print_line(f"motion: given, labels {given['labels']}; its source says: {given['source_says'] or 'nothing'}")
    noise, basis = given["acceleration_noise_m_s2"], given["acceleration_noise_basis"]
    print_line(f"noise of acceleration labels: {_word_noise(noise, basis)}")
    moved = given["moved_by_smoothing"]
    if moved is not None:
        print_line(
            f"smoothing moved it by {moved['rms_m']:.3f} m RMS, at most {moved['worst_m']:.3f} m, and turned it by at "
            f"most {moved['worst_heading_deg']:.2f} degrees"
        )


def _print_action_errors(summary: dict[str, Any]) -> None:
    """How far futures are from what the policy's actions can express, before smoothing where there was any."""
    before = summary["action_errors_before_smoothing"]
    if before is not None:
        print_line(f"action errors before smoothing: {word_action_errors(before)}")
    print_line(f"action errors: {word_action_errors(summary['action_errors'])}")


def word_action_errors(errors: dict[str, Any] | None) -> str:
    """Median, worst, and how many samples are beyond the tolerance."""
    if errors is None:
        return "not measured"
    return (
        f"median {errors['median_m']:.3f} m, worst {errors['worst_m']:.3f} m; {errors['beyond_tolerance']} of "
        f"{errors['samples']} samples beyond {errors['tolerance_m']:g} m"
    )


def _word_noise(noise: float | None, basis: str | None) -> str:
    return "not measured" if noise is None else f"{noise:.2f} m/s2, {basis}"


def _print_notes(summary: dict[str, Any]) -> None:
    for omission in summary["left_out"]:
        print_line(f"left out: {word_omission(Omission(**omission))}")
    for assumption in summary["assumptions"]:
        print_line(f"assumed: {assumption}")


def _print_pictures(summary: dict[str, Any]) -> None:
    if "pictures" in summary:
        print_line(f"pictures: {summary['pictures']['contact_sheet']}, {summary['pictures']['animation']}")


def _sample_line(clip: dict[str, Any]) -> str:
    times = clip["sample_t0_us"]
    if not times:
        return f"no policy sample: {clip['no_sample_reason']}"
    return f"policy samples: {len(times)}, t0 = {times[0] / 1e6:.1f} to {times[-1] / 1e6:.1f} s"
