"""How each view of a clip is made: taken as it is, cropped, or synthesized from the front view."""

from dataclasses import dataclass, field
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
from olt_generator.views.backend import GeometricBackend, ViewBackend, ViewSource
from olt_generator.views.lookback import LOOKBACK_LATENTS
from olt_generator.views.pixel_origin import PixelOrigin
from olt_generator.views.tele import crop_tele, tele_camera
from olt_toolkit.clips.clip import ClipOrigin, ViewKind, ViewProvenance
from olt_toolkit.clips.front import (
    border_origin,
    degrees_across,
    fit_width,
    fit_width_images,
    is_lens_of,
    see_through,
)
from olt_toolkit.clips.images import fit_images
from olt_toolkit.recordings.labels import UNLABELLED, Split
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT
from olt_toolkit.rigs.names import FrontLens, MotionLabels
from olt_toolkit.rigs.rig import FRONT_TELE, FRONT_WIDE, Rig
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
        front: with which lens the front-wide view is made where it is not a true one (`clips.front`).
        use_reference_views: take the recording's true images and trajectory instead of synthesizing: kind GT.
        use_reference_motion: take the recording's true trajectory although views are synthesized.
        labels: whether a true trajectory is taken as it is or smoothed; one that is recovered is smoothed in any case.
        poses, depth: where motion otherwise and distances come from.
        backend: makes the views that no camera recorded.
        image_kind: how the recording's own images came to be, for the provenance.
        name: None for the recording's name.
        scene_id: None for the source and the name of the recording, which suit one that no data set tells an id of.
        clip_id: None for that of these moments of the scene (`clips.identity`).
        build_options: see `ClipInfo`.
        category, factors, sample_t0_us: see `Clip`.
        split: None for the data set's own, or train where it has none.
        origin: what the recording was cut from; None where it is whole, and nothing more is known of it.
        seed: goes into the clip's id and provenance, and seeds what the backend draws by chance.
    """

    width: int = 576
    height: int = 320
    rig: Rig = field(default_factory=pav_rig)
    cameras: tuple[str, ...] = DEFAULT_CONTRACT.cameras
    front: FrontLens = FrontLens.AS_NAMED
    frames: Literal["all", "grid", "sampled"] = "grid"
    use_reference_views: bool = False
    use_reference_motion: bool = False
    labels: MotionLabels = MotionLabels.AS_MEASURED
    poses: PoseSource = estimate_odometry
    depth: DepthSource = estimate_distance
    backend: ViewBackend = field(default_factory=GeometricBackend)
    image_kind: ViewKind = "observed"
    name: str | None = None
    scene_id: str | None = None
    clip_id: str | None = None
    build_options: str | None = None
    category: str = UNLABELLED
    factors: tuple[str, ...] = ()
    split: Split | None = None
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
        origin: (n, height, width) uint8, a `PixelOrigin` per pixel; None where all are true.
        drawn_on: for each image the other front frames that it was made from; None where it is not synthesized.
        notes: a sentence for everything about the view that its name does not promise.
    """

    images: Images
    camera: Camera
    T_rig_camera: Array
    provenance: ViewProvenance
    origin: NDArray[np.uint8] | None = None
    drawn_on: tuple[tuple[int, ...], ...] | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ViewMaker:
    """Makes any view of a recording.

    Attributes:
        T_rig_front: (4, 4) mounting of the front camera, as corrected by the motion.
        source: of views that no camera recorded; None where nothing is synthesized.
    """

    recording: Recording
    options: BuildOptions
    T_rig_front: Array
    source: ViewSource | None

    def make(self, name: str, on_progress: Progress = silent) -> View:
        """Make one view; an `InputError` where its true images are not there, or the front lens cannot give it."""
        recording, size = self.recording, (self.options.width, self.options.height)
        if self.options.use_reference_views and name in recording.views:
            return self._true_view(name)
        if name == FRONT_WIDE:
            return self._front_wide()
        if name == FRONT_TELE:
            camera = tele_camera(recording.camera, *size)
            images = crop_tele(recording.frames, recording.camera, camera)
            return self._given(images, camera, self.T_rig_front, np.ones((size[1], size[0]), bool), "cropped")
        if self.source is None:
            raise InputError(f"{recording.name}: no true images of {name}; let it be synthesized instead")
        return self._synthesized(name, self.source, on_progress)

    def _front_wide(self) -> View:
        """The recording's own images: as they are, or through the lens of the named camera where theirs is another."""
        recording, size = self.recording, (self.options.width, self.options.height)
        named, camera = self.options.rig.fitted(*size)[FRONT_WIDE], fit_width(recording.camera, *size)
        kind, notes = self.options.image_kind, ()
        if not is_lens_of(camera, named.camera):
            across = [f"{degrees_across(each):.0f}" for each in (recording.camera, named.camera)]
            # A true view stays what it is.
            if self.options.front is FrontLens.AS_NAMED and not self.options.use_reference_views:
                images, seen, pose = see_through(recording.frames, recording.camera, self.T_rig_front, named)
                note = (
                    f"{FRONT_WIDE}: shown through the lens of that name, {across[1]} degrees across; the recording's "
                    f"camera has {across[0]}, and {1.0 - seen.mean():.0%} of the view is black."
                )
                return self._given(images, named.camera, pose, seen, kind, (note,))
            notes = (f"{FRONT_WIDE}: keeps the recording's lens, {across[0]} degrees across and not {across[1]}.",)
        images, rows = fit_width_images(recording.frames, *size)
        return self._given(images, camera, self.T_rig_front, np.repeat(rows[:, None], size[0], axis=1), kind, notes)

    def _true_view(self, name: str) -> View:
        images, size = self.recording.views[name], (self.options.width, self.options.height)
        mounted = self.recording.mounted.get(name) or self.options.rig.fitted(images.shape[2], images.shape[1])[name]
        camera, seen, kind = (
            fit_camera(mounted.camera, *size),
            np.ones((size[1], size[0]), bool),
            self.options.image_kind,
        )
        if name in self.recording.observed:
            shown = np.where(self.recording.observed[name], 255, 0).astype(np.uint8)
            # A pixel that is partly black is not taken for seen.
            seen = fit_images(np.repeat(shown[None, ..., None], 3, axis=-1), *size)[0, ..., 0] == 255
            kind = "mosaic"
        return self._given(fit_images(images, *size), camera, mounted.T_rig_camera, seen, kind)

    def _given(
        self,
        images: Images,
        camera: Camera,
        T_rig_camera: Array,
        seen: NDArray[np.bool_],
        kind: ViewKind,
        notes: tuple[str, ...] = (),
    ) -> View:
        """A view of which the recording shows the pixels (h, w) that are `seen`, and the others are black."""
        provenance = ViewProvenance(kind, self.recording.source, code_version(), None, 1.0, 0.0)
        if seen.all():
            return View(images, camera, T_rig_camera, provenance, notes=notes)
        origin = border_origin(seen, len(images))
        return View(images, camera, T_rig_camera, provenance.with_shares(origin), origin, notes=notes)

    def _synthesized(self, name: str, source: ViewSource, on_progress: Progress) -> View:
        target, backend = self.options.rig.fitted(self.options.width, self.options.height)[name], self.options.backend
        view = source.make(name, on_progress)
        provenance = ViewProvenance(
            kind=backend.kind,
            engine=backend.engine,
            version=code_version(),
            seed=self.options.seed,
            observed_share=0.0,
            invented_share=1.0,
        ).with_shares(view.origin)
        notes = tuple(f"{name}: {note}." for note in view.notes)
        blind = int((view.origin == PixelOrigin.INVENTED).all(axis=(1, 2)).sum())
        if blind:
            rear = name in LOOKBACK_LATENTS
            why = " (what lies behind is seen only once the vehicle has driven past it)" if rear else ""
            shown = f"the front camera saw nothing of {blind} of its {len(view.images)} images"
            notes = (f"{name}: {shown}; they are made up{why}.", *notes)
        return View(view.images, target.camera, target.T_rig_camera, provenance, view.origin, view.drawn_on, notes)
