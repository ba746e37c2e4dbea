"""From a front-camera recording to a clip: ego motion, distance, and the views that the policy eats."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import fit_camera
from olt_generator.doubts import Doubt
from olt_generator.errors import InputError
from olt_generator.metrics.image_metrics import psnr
from olt_generator.motion.smoother import smooth_trajectory
from olt_generator.omissions import Omission
from olt_generator.poses import Array
from olt_generator.progress import Progress, silent
from olt_generator.trajectory import Trajectory
from olt_generator.views.backend import Target, ViewSource
from olt_generator.views.front_view import FrontView
from olt_generator.views.lookback import LOOKBACK_LATENTS, lookback_frame
from olt_generator.views.moving_objects import check_distances
from olt_generator.views.pixel_origin import PixelOrigin
from olt_generator.views.view_plan import ViewPlan, plan_views
from olt_toolkit.clips.clip import CameraStream, Clip, ClipKind, ClipOrigin
from olt_toolkit.clips.feasibility import check_feasible
from olt_toolkit.clips.given_motion import GivenMotion
from olt_toolkit.clips.identity import clip_id_of
from olt_toolkit.clips.images import fit_images
from olt_toolkit.clips.recovered_motion import RecoveredMotion
from olt_toolkit.clips.views import BuildOptions, View, ViewMaker
from olt_toolkit.policy.window import grid_frame_indices, sampled_frame_indices
from olt_toolkit.recordings.labels import DEFAULT_SPLIT
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.ftheta_fit import fit_ftheta
from olt_toolkit.runtime.steps import OnStep, Steps, unnoticed

Indices = NDArray[np.int64]

# Expected shares of the run time, for the progress bar only.
_SHARES = {"odometry": 0.35, "smoothing": 0.02, "distance": 0.33, "views": 0.3}
# A table's lens is said to be inexact from this error on, pixels.
_NOTED_LENS_ERROR = 0.05


@dataclass(frozen=True)
class BuiltClip:
    """A clip, what it was made from, and how good that is. What could not be measured is None.

    Attributes:
        plan, left_out: which views were made, and how; what was not, and why.
        motion: as it was measured and smoothed, with its errors; None where the reference was taken.
        given: the reference where it was taken.
        doubts: why the clip may not be what it seems.
        distance_error: median relative error of the distances.
        view_errors: PSNR in dB of synthesized views against the true ones, mean over frames, by camera: "psnr" over all
            pixels, "psnr_observed" over those observed.
        seconds: run time by step.
        assumptions: a sentence for everything assumed instead of measured.
    """

    clip: Clip
    plan: ViewPlan
    left_out: tuple[Omission, ...]
    motion: RecoveredMotion | None
    given: GivenMotion | None
    doubts: tuple[Doubt, ...]
    distance_error: float | None
    view_errors: dict[str, dict[str, float]]
    seconds: dict[str, float]
    assumptions: tuple[str, ...]


def build_clip(
    recording: Recording,
    options: BuildOptions | None = None,
    on_progress: Progress = silent,
    on_step: OnStep = unnoticed,
) -> BuiltClip:
    """Build the clip of one recording.

    `on_progress` is told the share of the work that is done; `on_step` odometry, smoothing, distance, views.

    Raises:
        InputError: the motion cannot be recovered, a wanted view cannot be made, or a true view is not there.
    """
    options = options or BuildOptions()
    plan = plan_views(options.cameras)
    check_feasible(recording, options, plan)
    steps = Steps(_SHARES, on_progress, on_step)
    motion, at_frames, T_rig_camera = _measure_motion(recording, options, steps)
    needed = _needed_views(options, plan)
    made, drawn_on, with_distance = _choose_frames(recording, options, needed)

    source, distance_error = None, None
    if clip_kind(options) == "Syn":
        with steps.step("distance") as on_part:
            distance = options.depth(
                recording.frames, recording.camera, at_frames, T_rig_camera, on_part, with_distance
            )
        front = FrontView(
            recording.frames[with_distance],
            distance.distance,
            Trajectory(recording.timestamps_us[with_distance], at_frames.T_world_rig[with_distance]),
            recording.camera,
            T_rig_camera,
            distance.confidence,
            distance.moving,
            sources=np.searchsorted(with_distance, drawn_on),
            numbers=with_distance,
        )
        source = _start_source(check_distances(front), options, needed, np.searchsorted(with_distance, made))
        distance_error = _distance_error(distance.distance, recording, with_distance)

    shown = recording
    if len(made) < len(recording.frames):
        shown = replace(
            recording,
            frames=recording.frames[made],
            timestamps_us=recording.timestamps_us[made],
            views={name: images[made] for name, images in recording.views.items()},
        )
    maker = ViewMaker(shown, options, T_rig_camera, source)
    views: dict[str, View] = {}
    with steps.step("views") as on_part:
        for done, name in enumerate(plan.methods):
            views[name] = maker.make(name, lambda part, done=done: on_part((done + part) / len(plan.methods)))

    doubts = motion.doubts if isinstance(motion, RecoveredMotion) else recording.doubts
    return BuiltClip(
        clip=_assemble(shown, options, views, doubts, motion),
        plan=plan,
        left_out=(
            *(omission for omission in plan.left_out if omission.what not in needed),
            *_omissions(len(recording.frames), len(made), len(with_distance), views),
            *(() if source is None else source.left_out()),
        ),
        motion=motion if isinstance(motion, RecoveredMotion) else None,
        given=motion if isinstance(motion, GivenMotion) else None,
        doubts=doubts,
        distance_error=distance_error,
        view_errors=_view_errors(views, shown),
        seconds=steps.seconds,
        assumptions=recording.assumptions
        + tuple(note for view in views.values() for note in view.notes)
        + tuple(
            f"{name}: the f-theta polynomials of the clip's tables miss its lens by up to {error:.2f} px"
            for name, view in views.items()
            if (error := fit_ftheta(view.camera).error) > _NOTED_LENS_ERROR
        ),
    )


def clip_kind(options: BuildOptions) -> ClipKind:
    """What a clip that is built with these options is: by which views it has, and where they come from."""
    if not plan_views(options.cameras).synthesizes:
        return "front_only"
    return "GT" if options.use_reference_views else "Syn"


def _needed_views(options: BuildOptions, plan: ViewPlan) -> tuple[str, ...]:
    """The views that are synthesized, with those that only others are made from."""
    synthesized = [name for name, method in plan.methods.items() if method == "synthesized"]
    return options.backend.needed(synthesized) if clip_kind(options) == "Syn" else ()


def _start_source(front: FrontView, options: BuildOptions, needed: tuple[str, ...], indices: Indices) -> ViewSource:
    rig = options.rig.fitted(options.width, options.height)
    targets = {name: Target(rig[name].camera, rig[name].T_rig_camera) for name in needed}
    return options.backend.start(front, targets, indices.tolist(), options.seed)


def _measure_motion(
    recording: Recording, options: BuildOptions, steps: Steps
) -> tuple[RecoveredMotion | GivenMotion, Trajectory, Array]:
    """The clip's motion, the poses of the front images, and the mounting of the front camera."""
    times_us, reference = recording.timestamps_us, recording.reference
    if options.use_reference_views or options.use_reference_motion:
        if reference is None:
            raise InputError(f"{recording.name}: its true trajectory is not known; let it be estimated")
        at_frames = Trajectory(times_us, reference.interpolate(times_us))
        shown_us = int(times_us[0]), int(times_us[-1])
        given = GivenMotion.take(reference, shown_us, recording.accuracy, options.labels)
        return given, at_frames, recording.T_rig_camera
    with steps.step("odometry") as on_part:
        measured = options.poses(recording.frames, times_us, recording.camera, recording.T_rig_camera, on_part)
    with steps.step("smoothing"):
        smoothed = smooth_trajectory(measured.trajectory, measured.noise)
    recovered = RecoveredMotion(measured, smoothed, recording.spread, reference, recording.doubts)
    return recovered, smoothed.trajectory, measured.T_rig_camera


def _choose_frames(
    recording: Recording, options: BuildOptions, needed: tuple[str, ...]
) -> tuple[Indices, Indices, Indices]:
    """Indices of the frames that are made, of those that views draw on, and of those whose distances are needed.

    Views draw on what samples show up to the last frame that is made, so that they do not depend on which others are
    made. Distances are needed of both, and of the frames to which rear views look back.
    """
    on_grid = grid_frame_indices(recording.timestamps_us)
    made = {
        "all": np.arange(len(recording.frames)),
        "grid": on_grid,
        "sampled": sampled_frame_indices(recording.timestamps_us),
    }[options.frames]
    drawn_on = on_grid[on_grid <= made[-1]]
    offsets = [LOOKBACK_LATENTS[name] for name in needed if name in LOOKBACK_LATENTS]
    looked_back_to = [lookback_frame(frame, offset) for offset in offsets for frame in made.tolist()]
    return made, drawn_on, np.unique(np.concatenate([made, drawn_on, np.array(looked_back_to, np.int64)]))


def _assemble(
    recording: Recording,
    options: BuildOptions,
    views: dict[str, View],
    doubts: tuple[Doubt, ...],
    motion: RecoveredMotion | GivenMotion,
) -> Clip:
    times_us, name, kind = recording.timestamps_us, options.name or recording.name, clip_kind(options)
    # Video files need one constant rate, and readers take times from the timestamp tables: it only has to be close.
    rate = float(max(1, round(1e6 / float(np.median(np.diff(times_us))))))
    wanted = {camera: views[camera] for camera in options.cameras}
    scene_id = options.scene_id or f"{recording.source}/{recording.name}"
    origin = options.origin or ClipOrigin(recording.name, int(times_us[0]), int(times_us[-1]))
    window_us = (origin.start_us, origin.end_us)
    return Clip(
        clip_id=options.clip_id
        or clip_id_of(scene_id, "", window_us, kind, options.seed, options.front, options.backend.name),
        name=name,
        scene_id=scene_id,
        source=recording.source,
        origin=origin,
        kind=kind,
        category=options.category,
        factors=options.factors,
        split=options.split or DEFAULT_SPLIT,
        doubts=tuple(dict.fromkeys(doubt.what for doubt in doubts)),
        scale_sigma=motion.scale.total if isinstance(motion, RecoveredMotion) else None,
        acceleration_noise=motion.acceleration_noise,
        acceleration_noise_basis=motion.noise_basis,
        streams={
            camera: CameraStream(view.images, times_us, rate, view.camera, view.T_rig_camera, view.origin)
            for camera, view in wanted.items()
        },
        ego_motion=motion.ego_motion,
        vehicle=recording.vehicle,
        provenance={camera: view.provenance for camera, view in wanted.items()},
        sample_t0_us=options.sample_t0_us,
        build_options=options.build_options,
        route=recording.route,
        obstacles=recording.obstacles,
        holds=recording.holds,
        road=recording.road,
    )


def _omissions(count: int, made: int, with_distance: int, views: dict[str, View]) -> Iterator[Omission]:
    """Which of `count` frames were not made and not measured, and which the synthesized images were not made from."""
    if made < count:
        yield Omission("frames of each view", "no sample with t0 on the 0.1 s grid shows them", count - made, count)
    synthesized = [frames for view in views.values() for frames in view.drawn_on or ()]
    if not synthesized:
        yield Omission("distances of front frames", "no view is synthesized", count, count)
        return
    if with_distance < count:
        why = "no view is made of them or draws on them"
        yield Omission("distances of front frames", why, count - with_distance, count)
    others = len(synthesized) * (with_distance - 1)
    yield Omission(
        "other front frames of the synthesized images",
        "the frames drawn on show most of what the front camera saw of them",
        others - sum(map(len, synthesized)),
        others,
    )


def _distance_error(distance: NDArray[np.float32], recording: Recording, frames: Indices) -> float | None:
    """Median relative error of the distances (m, H, W) of m frames where there is a true one and an estimate."""
    if recording.distance is None:
        return None
    truth = recording.distance[frames]
    both = np.isfinite(truth) & np.isfinite(distance)
    return float(np.median(np.abs(distance[both] - truth[both]) / truth[both]))


def _view_errors(views: dict[str, View], recording: Recording) -> dict[str, dict[str, float]]:
    """Errors of the synthesized views whose true images are known: whole, by the same lens, from the same place."""
    errors = {}
    for name, view in views.items():
        if view.drawn_on is None or view.origin is None or name not in recording.views or name in recording.observed:
            continue
        _, height, width, _ = view.images.shape
        true = recording.mounted.get(name)
        if true is not None and (
            fit_camera(true.camera, width, height) != view.camera
            or not np.array_equal(true.T_rig_camera, view.T_rig_camera)
        ):
            continue
        truth = fit_images(recording.views[name], width, height)
        triples = list(zip(view.images, truth, view.origin != PixelOrigin.INVENTED, strict=True))
        all_pixels = [psnr(image, true_image) for image, true_image, _ in triples]
        observed = [psnr(image, true_image, seen) for image, true_image, seen in triples if seen.any()]
        errors[name] = {"psnr": float(np.mean(all_pixels)), "psnr_observed": float(np.mean(observed))}
    return errors
