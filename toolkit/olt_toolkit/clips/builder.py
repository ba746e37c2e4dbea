"""From a front-camera recording to a clip: ego motion, distance, and the views that the policy eats."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import fit_camera
from olt_generator.distance.depth import DistanceEstimate
from olt_generator.errors import InputError
from olt_generator.metrics.image_metrics import psnr
from olt_generator.motion.pose_metrics import PoseErrors, compare_trajectories
from olt_generator.motion.pose_sources import PoseEstimate
from olt_generator.motion.smoother import SmoothedMotion, smooth_trajectory
from olt_generator.poses import Array
from olt_generator.progress import Progress, silent
from olt_generator.trajectory import Trajectory
from olt_generator.views.front_view import FrontView
from olt_generator.views.lookback import LOOKBACK_LATENTS, lookback_frame
from olt_generator.views.moving_objects import find_moving
from olt_generator.views.view_plan import ViewPlan, plan_views
from olt_toolkit.clips.clip import CameraStream, Clip, ClipKind, ClipOrigin, EgoMotion, make_clip_id
from olt_toolkit.clips.images import fit_images
from olt_toolkit.clips.views import BuildOptions, View, ViewMaker
from olt_toolkit.policy.label_noise import LabelNoiseBudget, measure_label_noise
from olt_toolkit.policy.window import sampled_frames, shown_frames
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.ftheta_fit import fit_ftheta
from olt_toolkit.runtime.steps import OnStep, Steps, unnoticed

# Expected shares of the run time, for the progress bar only.
_SHARES = {"odometry": 0.35, "smoothing": 0.02, "distance": 0.33, "views": 0.3}
# A table's lens is said to be inexact from this error on, pixels.
_NOTED_LENS_ERROR = 0.05


@dataclass(frozen=True)
class ViewError:
    """PSNR in dB of a synthesized view against the true one, mean over frames: all pixels, and those observed."""

    psnr: float
    psnr_observed: float


@dataclass(frozen=True)
class BuiltClip:
    """A clip, what it was made from, and how good that is. What could not be measured is None.

    Attributes:
        clip: the clip.
        plan: which views were made, and how.
        left_out: what was not made, and why.
        measured: the trajectory as it was measured; None where the reference was taken.
        motion: the smoothed trajectory; None where the reference was taken.
        distance: distances of the front images that views are made of or draw on; None where no view needs them.
        observed: (m, h, w) pixels taken from what the front camera saw, by synthesized view.
        pose_errors: errors of the smoothed trajectory.
        raw_pose_errors: errors of the trajectory before smoothing.
        label_noise: what errors of the trajectory do to the policy's labels.
        distance_error: median relative error of the distances.
        view_errors: errors of synthesized views, by camera.
        seconds: run time by step.
        assumptions: a sentence for everything assumed instead of measured.
    """

    clip: Clip
    plan: ViewPlan
    left_out: dict[str, str]
    measured: PoseEstimate | None
    motion: SmoothedMotion | None
    distance: DistanceEstimate | None
    observed: dict[str, NDArray[np.bool_]]
    pose_errors: PoseErrors | None
    raw_pose_errors: PoseErrors | None
    label_noise: LabelNoiseBudget | None
    distance_error: float | None
    view_errors: dict[str, ViewError]
    seconds: dict[str, float]
    assumptions: tuple[str, ...]


def clip_id_of(recording: Recording, options: BuildOptions) -> str:
    """The id of the clip that `build_clip` would build."""
    kind = _clip_kind(options, plan_views(options.cameras))
    return make_clip_id(recording.source, options.name or recording.name, kind, options.seed)


@dataclass(frozen=True)
class _Motion:
    """How the rig moved, and how the front camera sits on it."""

    ego: EgoMotion
    trajectory: Trajectory
    T_rig_camera: Array
    measured: PoseEstimate | None = None
    smoothed: SmoothedMotion | None = None


def build_clip(
    recording: Recording,
    options: BuildOptions | None = None,
    on_progress: Progress = silent,
    on_step: OnStep = unnoticed,
) -> BuiltClip:
    """Build the clip of one recording.

    Args:
        recording: front images, lens and mounting, and the truth where it is known.
        options: what to build.
        on_progress: told the share of the work that is done.
        on_step: told each step's name: odometry, smoothing, distance, views.

    Raises:
        InputError: the motion cannot be recovered, a wanted view cannot be made, or a true view is not there.
    """
    options = options or BuildOptions()
    plan = plan_views(options.cameras)
    steps = Steps(_SHARES, on_progress, on_step)
    motion = _measure_motion(recording, options, steps)
    synthesizes = _clip_kind(options, plan) == "Syn"
    kept = _kept_frames(recording, options)
    shown = _only_frames(recording, kept)
    sources = _frames_drawn_on(recording, kept)
    needed = _frames_with_distance(plan, kept, sources) if synthesizes else kept
    distance = _estimate_distance(recording, options, motion, needed, steps) if synthesizes else None
    front = None if distance is None else _front_view(recording, motion, distance, needed, sources)
    maker = ViewMaker(shown, options, motion.T_rig_camera, front, np.searchsorted(needed, kept))
    views = _make_views(maker, plan, steps)
    return BuiltClip(
        clip=_assemble(shown, options, plan, views, motion.ego),
        plan=plan,
        left_out={omission.what: omission.why for omission in plan.left_out}
        | _frames_left_out(len(recording.frames), len(kept))
        | _distances_left_out(len(recording.frames), len(needed))
        | _sources_left_out(len(needed), views),
        measured=motion.measured,
        motion=motion.smoothed,
        distance=distance,
        observed={name: view.observed for name, view in views.items() if view.observed is not None},
        pose_errors=_pose_errors(motion.smoothed, recording),
        raw_pose_errors=_pose_errors(motion.measured, recording),
        label_noise=_label_noise(motion, recording),
        distance_error=_distance_error(distance, _only_frames(recording, needed)),
        view_errors=_view_errors(views, shown),
        seconds=steps.seconds,
        assumptions=(*recording.assumptions, *_lens_notes(views)),
    )


def _measure_motion(recording: Recording, options: BuildOptions, steps: Steps) -> _Motion:
    if options.use_reference_views or options.use_reference_motion:
        if recording.reference is None:
            raise InputError(f"{recording.name}: its true trajectory is not known; let it be estimated")
        at_frames = Trajectory(recording.timestamps_us, recording.reference.interpolate(recording.timestamps_us))
        return _Motion(EgoMotion.from_trajectory(recording.reference), at_frames, recording.T_rig_camera)
    with steps.step("odometry") as on_progress:
        measured = options.poses.estimate(
            recording.frames, recording.timestamps_us, recording.camera, recording.T_rig_camera, on_progress
        )
    with steps.step("smoothing"):
        smoothed = smooth_trajectory(measured.trajectory, measured.noise)
    ego = EgoMotion.anchored(smoothed.trajectory, smoothed.velocity, smoothed.acceleration, smoothed.curvature)
    return _Motion(ego, smoothed.trajectory, measured.T_rig_camera, measured, smoothed)


def _estimate_distance(
    recording: Recording, options: BuildOptions, motion: _Motion, needed: NDArray[np.int64], steps: Steps
) -> DistanceEstimate:
    with steps.step("distance") as on_progress:
        return options.depth.estimate(
            recording.frames, recording.camera, motion.trajectory, motion.T_rig_camera, on_progress, needed
        )


def _frames_with_distance(plan: ViewPlan, kept: NDArray[np.int64], sources: NDArray[np.int64]) -> NDArray[np.int64]:
    """The frames that are made, those that views draw on, and those to which rear views look back."""
    offsets = [LOOKBACK_LATENTS[name] for name in plan.methods if name in LOOKBACK_LATENTS]
    looked_back_to = [lookback_frame(frame, offset) for offset in offsets for frame in kept.tolist()]
    return np.unique(np.concatenate([kept, sources, np.array(looked_back_to, np.int64)]))


def _front_view(
    recording: Recording,
    motion: _Motion,
    distance: DistanceEstimate,
    needed: NDArray[np.int64],
    sources: NDArray[np.int64],
) -> FrontView:
    """The needed frames, of which views draw on the sources."""
    front = FrontView(
        recording.frames[needed],
        distance.distance,
        Trajectory(recording.timestamps_us[needed], motion.trajectory.T_world_rig[needed]),
        recording.camera,
        motion.T_rig_camera,
        distance.confidence,
        sources=np.searchsorted(needed, sources),
        numbers=needed,
    )
    return replace(front, moving=distance.moving | find_moving(front))


def _kept_frames(recording: Recording, options: BuildOptions) -> NDArray[np.int64]:
    if options.frames == "all":
        return np.arange(len(recording.frames))
    return (shown_frames if options.frames == "shown" else sampled_frames)(recording.timestamps_us)


def _frames_drawn_on(recording: Recording, kept: NDArray[np.int64]) -> NDArray[np.int64]:
    """What samples show up to the last frame that is made, so that views do not depend on which others are made."""
    shown = shown_frames(recording.timestamps_us)
    return shown[shown <= kept[-1]]


def _only_frames(recording: Recording, kept: NDArray[np.int64]) -> Recording:
    """The recording with these of its images; its reference trajectory stays whole."""
    if len(kept) == len(recording.frames):
        return recording
    return replace(
        recording,
        frames=recording.frames[kept],
        timestamps_us=recording.timestamps_us[kept],
        distance=None if recording.distance is None else recording.distance[kept],
        views={name: images[kept] for name, images in recording.views.items()},
    )


def _frames_left_out(count: int, kept: int) -> dict[str, str]:
    if kept == count:
        return {}
    return {f"{count - kept} of {count} frames of each view": "no sample with t0 on the 0.1 s grid shows them"}


def _distances_left_out(count: int, needed: int) -> dict[str, str]:
    if needed == count:
        return {}
    return {f"distances of {count - needed} of {count} front frames": "no view is made of them or draws on them"}


def _sources_left_out(count: int, views: dict[str, View]) -> dict[str, str]:
    """Which front frames the synthesized images were not made from."""
    drawn_on = [len(frames) for view in views.values() for frames in view.drawn_on or ()]
    if not drawn_on:
        return {}
    others = (
        f"on average {count - 1 - np.mean(drawn_on):.1f} of {count - 1} other front frames of each synthesized image"
    )
    return {others: "the frames drawn on show most of what the front camera saw of it"}


def _make_views(maker: ViewMaker, plan: ViewPlan, steps: Steps) -> dict[str, View]:
    views = {}
    with steps.step("views") as on_progress:
        for done, name in enumerate(plan.methods):
            views[name] = maker.make(name, lambda part, done=done: on_progress((done + part) / len(plan.methods)))
    return views


def _assemble(
    recording: Recording, options: BuildOptions, plan: ViewPlan, views: dict[str, View], ego_motion: EgoMotion
) -> Clip:
    return Clip(
        clip_id=clip_id_of(recording, options),
        name=options.name or recording.name,
        scene_id=options.scene_id or recording.name,
        source=recording.source,
        origin=options.origin or _whole_recording(recording),
        kind=_clip_kind(options, plan),
        category=options.category,
        factors=options.factors,
        split=options.split,
        streams={camera: _stream(views[camera], recording.timestamps_us) for camera in options.cameras},
        ego_motion=ego_motion,
        vehicle=recording.vehicle,
        provenance={camera: views[camera].provenance for camera in options.cameras},
        sample_t0_us=options.sample_t0_us,
    )


def _whole_recording(recording: Recording) -> ClipOrigin:
    return ClipOrigin(recording.name, int(recording.timestamps_us[0]), int(recording.timestamps_us[-1]))


def _stream(view: View, timestamps_us: NDArray[np.int64]) -> CameraStream:
    return CameraStream(view.images, timestamps_us, nominal_frame_rate(timestamps_us), view.camera, view.T_rig_camera)


def nominal_frame_rate(timestamps_us: NDArray[np.int64]) -> float:
    """Whole frames per second nearest to the median spacing of the frames.

    Video files need one constant rate, and readers take times from the timestamp tables, so it only has to be close.
    """
    return float(max(1, round(1e6 / float(np.median(np.diff(timestamps_us))))))


def _clip_kind(options: BuildOptions, plan: ViewPlan) -> ClipKind:
    if not plan.synthesizes:
        return "front_only"
    return "GT" if options.use_reference_views else "Syn"


def _pose_errors(measured: PoseEstimate | SmoothedMotion | None, recording: Recording) -> PoseErrors | None:
    if measured is None or recording.reference is None:
        return None
    return compare_trajectories(measured.trajectory, recording.reference)


def _label_noise(motion: _Motion, recording: Recording) -> LabelNoiseBudget | None:
    """None where the reference was taken, or where the recording is too short for labels."""
    if motion.measured is None or motion.smoothed is None:
        return None
    return measure_label_noise(motion.measured.trajectory, motion.smoothed, recording.reference)


def _distance_error(distance: DistanceEstimate | None, recording: Recording) -> float | None:
    """Median relative error where there is a true distance and an estimate."""
    if distance is None or recording.distance is None:
        return None
    both = np.isfinite(recording.distance) & np.isfinite(distance.distance)
    truth = recording.distance[both]
    return float(np.median(np.abs(distance.distance[both] - truth) / truth))


def _view_errors(views: dict[str, View], recording: Recording) -> dict[str, ViewError]:
    """Errors of the synthesized views whose true images are known."""
    return {
        name: _view_error(view.images, view.observed, recording.views[name])
        for name, view in views.items()
        if view.observed is not None and _shows_the_same(view, name, recording)
    }


def _shows_the_same(view: View, name: str, recording: Recording) -> bool:
    """Whether the true images are whole, and seen through the lens of the view from its place."""
    if name not in recording.views or name in recording.observed:
        return False
    true = recording.mounted.get(name)
    if true is None:
        return True
    lens = fit_camera(true.camera, view.camera.width, view.camera.height)
    return lens == view.camera and np.array_equal(true.T_rig_camera, view.T_rig_camera)


def _view_error(images: NDArray[np.uint8], observed: NDArray[np.bool_], true_images: NDArray[np.uint8]) -> ViewError:
    truth = fit_images(true_images, images.shape[2], images.shape[1])
    partly_seen = [index for index in range(len(images)) if observed[index].any()]
    return ViewError(
        float(np.mean([psnr(image, true) for image, true in zip(images, truth, strict=True)])),
        float(np.mean([psnr(images[index], truth[index], observed[index]) for index in partly_seen])),
    )


def _lens_notes(views: dict[str, View]) -> list[str]:
    errors = {name: fit_ftheta(view.camera).error for name, view in views.items()}
    return [
        f"{name}: the f-theta polynomials of the clip's tables miss its lens by up to {error:.2f} px"
        for name, error in errors.items()
        if error > _NOTED_LENS_ERROR
    ]
