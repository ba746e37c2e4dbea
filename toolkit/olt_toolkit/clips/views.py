"""How each view of a clip is made: taken as it is, cropped, or synthesized from the front view."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, fit_camera
from olt_generator.distance.depth import estimate_distance
from olt_generator.distance.depth_source import DepthSource
from olt_generator.errors import InputError
from olt_generator.motion.odometry import estimate_odometry
from olt_generator.motion.pose_sources import PoseSource
from olt_generator.poses import Array
from olt_generator.progress import Progress, silent
from olt_generator.views.front_view import FrontView
from olt_generator.views.lookback import LOOKBACK_LATENTS
from olt_generator.views.synthesis import PixelOrigin, SynthesisSettings, synthesize_view
from olt_generator.views.tele import crop_tele, tele_camera
from olt_toolkit.clips.clip import ClipOrigin, ViewKind, ViewProvenance
from olt_toolkit.clips.images import fit_images
from olt_toolkit.recordings.labels import UNLABELLED, Split
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import FRONT_TELE, FRONT_WIDE, POLICY_CAMERAS, Rig
from olt_toolkit.rigs.rig_files import pav_rig
from olt_toolkit.runtime.version import code_version

Images = NDArray[np.uint8]


@dataclass(frozen=True)
class BuildOptions:
    """How a clip is built.

    Attributes:
        width, height: size of all views in pixels, even because video is coded in blocks of two.
        rig, cameras: the rig whose views are wanted, and which; synthesized views are seen from its cameras.
        frames: which frames are made: "all"; those that samples with t0 on the 0.1 s "grid" take, of this clip or one
            that goes on, which at 30 Hz is one in three; or those alone that are "sampled" from this clip, which leaves
            out its first 1.4 s and last 6.4 s.
        use_reference_views: take the recording's true images and trajectory instead of synthesizing: kind GT.
        use_reference_motion: take the recording's true trajectory although views are synthesized.
        poses, depth: where motion otherwise and distances come from.
        image_kind: how the recording's own images came to be, for the provenance.
        name, scene_id: None for the recording's name.
        category, factors, split, sample_t0_us: see `Clip`.
        origin: what the recording was cut from; None where it is whole, and nothing more is known of it.
        seed: goes into the clip's id and provenance; nothing in the build is random yet.
    """

    width: int = 576
    height: int = 320
    rig: Rig = field(default_factory=pav_rig)
    cameras: tuple[str, ...] = POLICY_CAMERAS
    frames: Literal["all", "grid", "sampled"] = "grid"
    use_reference_views: bool = False
    use_reference_motion: bool = False
    poses: PoseSource = estimate_odometry
    depth: DepthSource = estimate_distance
    image_kind: ViewKind = "observed"
    name: str | None = None
    scene_id: str | None = None
    category: str = UNLABELLED
    factors: tuple[str, ...] = ()
    split: Split = "train"
    origin: ClipOrigin | None = None
    sample_t0_us: tuple[int, ...] | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.width % 2 or self.height % 2 or min(self.width, self.height) < 2:
            raise InputError(f"views of {self.width} x {self.height} pixels: width and height must be even")


@dataclass(frozen=True)
class View:
    """The images (n, height, width, 3) of one camera, with its lens and mounting (4, 4), and where pixels came from.

    Attributes:
        observed: (n, height, width) pixels taken from what the front camera saw; None where all are true.
        drawn_on: for each image the other front frames that it was made from; None where all are true.
    """

    images: Images
    camera: Camera
    T_rig_camera: Array
    provenance: ViewProvenance
    observed: NDArray[np.bool_] | None = None
    drawn_on: tuple[tuple[int, ...], ...] | None = None


@dataclass(frozen=True)
class ViewMaker:
    """Makes any view of a recording.

    Attributes:
        T_rig_front: (4, 4) mounting of the front camera, as corrected by the motion.
        front: images of the front camera with their distances; None where nothing is synthesized.
        indices: (n,) numbers of the recording's images among those of `front`.
    """

    recording: Recording
    options: BuildOptions
    T_rig_front: Array
    front: FrontView | None
    indices: NDArray[np.int64]

    def make(self, name: str, on_progress: Progress = silent) -> View:
        """Make one view; an `InputError` where its true images are not there, or the front lens cannot give it."""
        recording, size = self.recording, (self.options.width, self.options.height)
        if self.options.use_reference_views and name in recording.views:
            return self._true_view(name)
        if name == FRONT_WIDE:
            images, camera = fit_images(recording.frames, *size), fit_camera(recording.camera, *size)
            return View(images, camera, self.T_rig_front, self._as_given(self.options.image_kind))
        if name == FRONT_TELE:
            camera = tele_camera(recording.camera, *size)
            images = crop_tele(recording.frames, recording.camera, camera)
            return View(images, camera, self.T_rig_front, self._as_given("cropped"))
        if self.front is None:
            raise InputError(f"{recording.name}: no true images of {name}; let it be synthesized instead")
        return self._synthesized(name, self.front, on_progress)

    def _true_view(self, name: str) -> View:
        images, size = self.recording.views[name], (self.options.width, self.options.height)
        mounted = self.recording.mounted.get(name) or self.options.rig.fitted(images.shape[2], images.shape[1])[name]
        provenance = self._as_given(self.options.image_kind)
        if name in self.recording.observed:
            seen = np.where(self.recording.observed[name], 255, 0).astype(np.uint8)
            share = float(fit_images(np.repeat(seen[None, ..., None], 3, axis=-1), *size).mean()) / 255.0
            provenance = replace(provenance, kind="mosaic", observed_share=share, invented_share=1.0 - share)
        return View(fit_images(images, *size), fit_camera(mounted.camera, *size), mounted.T_rig_camera, provenance)

    def _synthesized(self, name: str, front: FrontView, on_progress: Progress) -> View:
        target = self.options.rig.fitted(self.options.width, self.options.height)[name]
        settings = SynthesisSettings(lookback=LOOKBACK_LATENTS.get(name))
        indices = self.indices.tolist()
        view = synthesize_view(front, target.camera, target.T_rig_camera, indices, settings, on_progress)
        same_frame, other_frame = (
            float((view.origin == origin).mean()) for origin in (PixelOrigin.SAME_FRAME, PixelOrigin.OTHER_FRAME)
        )
        provenance = ViewProvenance(
            kind="warped",
            engine="olt_generator.views.synthesis",
            version=code_version(),
            seed=self.options.seed,
            observed_share=same_frame + other_frame,
            invented_share=1.0 - (same_frame + other_frame),
            other_times_share=other_frame,
        )
        observed = view.origin != PixelOrigin.INVENTED
        return View(view.images, target.camera, target.T_rig_camera, provenance, observed, view.drawn_on)

    def _as_given(self, kind: ViewKind) -> ViewProvenance:
        return ViewProvenance(kind, self.recording.source, code_version(), None, 1.0, 0.0)
