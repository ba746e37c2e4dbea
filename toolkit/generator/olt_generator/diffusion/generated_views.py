"""The views of a clip by the learned engine (paper, Algorithm 1), as the rig's own cameras see them.

Each view is sampled once, as soon as it, or one that is conditioned on it, is asked for. The engine works on
straight-lined images; what it decodes is bent to the lens of the rig, and takes the place of what the geometric engine
invents. What the front camera saw stays as the geometric engine warps it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from olt_generator.cameras import Camera, PinholeCamera, remap_table
from olt_generator.diffusion.engine_folder import Engine
from olt_generator.diffusion.generation import (
    GenerationSettings,
    MemorizedView,
    WindowGeometry,
    cells_of,
    digest_inputs,
    draw_noise,
    gather_conditions,
    needed_pixels,
    sample_view,
)
from olt_generator.diffusion.observed_pixels import keep_observed
from olt_generator.diffusion.rectified import latent_steps, rectified_camera
from olt_generator.diffusion.tiled_decoding import decode_needed
from olt_generator.diffusion.view_graph import VIEWS, conditions_of, order_views
from olt_generator.diffusion.warp_control import cell_visibility, vace_control, warp_prior
from olt_generator.diffusion.windows import blend_windows, first_latent, plan_windows
from olt_generator.files import write_whole
from olt_generator.lenses.remap import Remapper
from olt_generator.omissions import Omission
from olt_generator.progress import Progress, silent
from olt_generator.views.backend import GeometricViews, Target
from olt_generator.views.front_view import FrontView
from olt_generator.views.pixel_origin import PixelOrigin
from olt_generator.views.synthesis import SynthesisSettings, SynthesizedView

Video = NDArray[np.uint8]
Mask = NDArray[np.bool_]

# Share by which the time between frames may differ from that of training without a word.
_NOTED_SPACING = 0.1


@dataclass(frozen=True)
class _Prior:
    """What the warp shows of a view (n, h, w, 3), and how far it is seen (n, h, w), of `warp_prior`."""

    images: Video
    visible: NDArray[np.float32]


class GeneratedViews:
    """See `views.backend.ViewSource`.

    Args:
        front, targets, indices, seed: see `views.backend.ViewBackend.start`.
        keep: folder in which the latents of each view and window stay until the clip is done, so that a run that is
            taken up again samples none twice; None to keep nothing.
    """

    def __init__(
        self,
        engine: Engine,
        settings: GenerationSettings,
        front: FrontView,
        targets: Mapping[str, Target],
        indices: Sequence[int],
        seed: int,
        keep: Path | None = None,
    ) -> None:
        self._engine, self._settings, self._front, self._targets = engine, settings, front, targets
        self._indices, self._seed, self._keep = list(indices), seed, keep
        self._geometric = GeometricViews(front, targets, self._indices, SynthesisSettings())
        self._windows = plan_windows(len(self._indices), settings.window, settings.overlap)
        self._latents: dict[int, tuple[Tensor, ...]] = {}
        self._videos: dict[int, dict[int, Video]] = {}
        self._tiles = np.zeros(2, np.int64)

    def make(self, name: str, on_progress: Progress = silent) -> SynthesizedView:
        """See `ViewSource.make`."""
        missing = [each for each in order_views([name], most=self._most).views if each not in self._latents]
        for done, each in enumerate(missing):
            self._sample(each, lambda part, done=done: on_progress((done + part) / (len(missing) + 1)))
        return self._bend(name)

    def left_out(self) -> tuple[Omission, ...]:
        """See `ViewSource.left_out`."""
        settings = self._settings
        told = []
        if self._tiles[0]:
            told.append(
                Omission("tiles of generated videos", "the front camera saw all of them", *self._tiles.tolist())
            )
        unguided = {settings.guidance(view) for view in self._latents if view > 0} & {1.0}
        if unguided:
            told.append(Omission("passes without the prompt", "the guidance is 1"))
        return tuple(told)

    @property
    def _most(self) -> int:
        return self._settings.conditions if self._engine.facts.config.conditioning.memory else 0

    @property
    def _size(self) -> tuple[int, int]:
        return self._engine.facts.width, self._engine.facts.height

    @cached_property
    def _geometries(self) -> tuple[WindowGeometry, ...]:
        poses = self._front.camera_poses[self._indices]
        steps = latent_steps(len(self._windows[0]))
        return tuple(WindowGeometry(poses[window.start + steps], self._front.T_rig_camera) for window in self._windows)

    def _camera(self, view: int) -> PinholeCamera:
        lens = self._front.camera if view == 0 else self._targets[VIEWS[view]].camera
        return rectified_camera(lens, *self._size)

    def _rays(self, view: int, geometry: WindowGeometry) -> Tensor:
        mounting = self._front.T_rig_camera if view == 0 else self._targets[VIEWS[view]].T_rig_camera
        return geometry.rays(self._camera(view), mounting)

    def _memorize(self, view: int, window: int) -> MemorizedView:
        """A view that is given or was sampled, in one window."""
        if view == 0 and 0 not in self._latents:
            remapper = Remapper(self._front.camera, self._camera(0), np.eye(3))
            video = remapper.remap(self._front.frames[self._indices])
            self._latents[0] = tuple(self._encode(video[each.start : each.stop]) for each in self._windows)
        return MemorizedView(view, self._latents[view][window], self._rays(view, self._geometries[window]))

    def _encode(self, video: Video) -> Tensor:
        return self._engine.codec.encode(torch.from_numpy(video)[None]).cpu()

    def _sample(self, view: int, on_progress: Progress) -> None:
        """Sample all windows of a view, each after the one before, whose last frames it goes on from."""
        warped = self._geometric.make_through(VIEWS[view], self._camera(view))
        fill = self._engine.facts.config.conditioning.fill
        prior = _Prior(*warp_prior(warped.images, warped.origin, fill))
        sampled: list[Tensor] = []
        self._videos[view] = {}
        for number, window in enumerate(self._windows):
            before = None
            if number > 0:
                last = self._windows[number - 1]
                hidden = (prior.visible[window.start : last.stop] == 0.0).any(axis=0)
                before = last, self._decode(view, number - 1, sampled[-1], hidden)
                # Whole images serve the view too; of tiles it may need others.
                if self._settings.tile is None and hidden.any():
                    self._videos[view][number - 1] = before[1]
            cut = _cut(prior, window, before)
            encoded = self._encode(cut.images)
            sampled.append(self._sample_window(view, number, encoded, cut.visible))
            on_progress((number + 1) / len(self._windows))
        self._latents[view] = tuple(sampled)

    def _sample_window(self, view: int, number: int, encoded: Tensor, visible: NDArray[np.float32]) -> Tensor:
        """The latents of a window, from those of its warp and how far each of its pixels (n, h, w) is seen."""
        engine, geometry, window = self._engine, self._geometries[number], self._windows[number]
        visibility = cell_visibility(torch.from_numpy(visible)[None])
        control = vace_control(encoded, visibility, engine.facts.layout)
        memory = [self._memorize(each, number) for each in conditions_of(view, self._most)]
        conditions = gather_conditions(engine, view, self._rays(view, geometry), geometry.motion(), control, memory)
        shape = (len(geometry.T_world_front), *cells_of(*self._size))
        noise = draw_noise(self._seed, view, first_latent(window), shape, self._settings.shared_noise)
        if self._keep is None:
            return sample_view(engine, view, conditions, noise, self._settings)
        settings = self._settings
        how = (engine.digest, settings.steps, settings.solver, settings.guidance(view), str(engine.dtype))
        kept = self._keep / f"{VIEWS[view]}.{number}.{digest_inputs(conditions, noise, *how)}.safetensors"
        found = _load_kept(kept)
        if found is None:
            found = sample_view(engine, view, conditions, noise, settings)
            with write_whole(kept) as temporary:
                save_file({"latents": found}, temporary)
        return found

    def _decode(self, view: int, window: int, latents: Tensor, needed: Mask) -> Video:
        """The video of the latents of a window, right where pixels (h, w) are needed."""
        decoded = decode_needed(self._engine.codec, latents, needed, self._settings.tile)
        self._tiles += np.array([decoded.left_out, decoded.tiles])
        return decoded.video

    def _bend(self, name: str) -> SynthesizedView:
        """The view through the lens of the rig, generated where the front camera saw nothing."""
        view, target = VIEWS.index(name), self._targets[name]
        warped = self._geometric.make(name)
        remapper = Remapper(self._camera(view), target.camera, np.eye(3))
        free = np.broadcast_to(remapper.seen, warped.origin.shape)
        if self._settings.keep_observed:
            free = free & (warped.origin == PixelOrigin.INVENTED)
        known = self._videos.pop(view, {})
        videos = [
            known[number]
            if number in known
            else self._decode(
                view, number, latents, self._look_up(view, target.camera, free[window.start : window.stop])
            )
            for number, (latents, window) in enumerate(zip(self._latents[view], self._windows, strict=True))
        ]
        generated, notes = (
            remapper.remap(blend_windows(videos, self._windows)),
            self._notes(float(np.mean(remapper.seen))),
        )
        if self._settings.keep_observed:
            images = keep_observed(generated, warped.images, free)
        else:
            images = np.where(free[..., None], generated, warped.images)
        origin = np.where(free, np.uint8(PixelOrigin.INVENTED), warped.origin)
        return replace(warped, images=images, origin=origin, notes=notes)

    def _look_up(self, view: int, lens: Camera, free: Mask) -> Mask:
        """Straight-lined pixels (h, w) that enter pixels of the lens which are free (n, h', w') in any image."""
        table, seen = remap_table(self._camera(view), lens, np.eye(3))
        here = free.any(axis=0) & seen
        width, height = self._size
        looked_at = np.zeros((height, width), bool)
        if here.any():
            u, v = np.rint(table[here]).astype(int).T
            looked_at[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)] = True
        # A colour is interpolated in a mip level whose pixels are about as far apart as what neighbours look up.
        apart = max(float(np.abs(np.diff(table, axis=axis))[_both(seen, axis)].max(initial=1.0)) for axis in (0, 1))
        return needed_pixels(looked_at, int(np.ceil(2.0 * apart)) + 2)

    def _notes(self, seen: float) -> tuple[str, ...]:
        notes = []
        if seen < 1.0:
            notes.append(f"{1.0 - seen:.1%} of the view lies outside of what the engine makes, and is warped")
        trained = self._engine.facts.frame_us
        times_us = self._front.trajectory.timestamps_us[self._indices]
        spacing = float(np.median(np.diff(times_us))) if len(times_us) > 1 else None
        if trained is None:
            notes.append("the engine does not tell the time between frames that it was trained with")
        elif spacing is not None and abs(spacing / trained - 1.0) > _NOTED_SPACING:
            notes.append(
                f"the engine was trained with {trained / 1e3:.3g} ms between frames, and here are {spacing / 1e3:.3g}"
            )
        return tuple(notes)


def _cut(prior: _Prior, window: range, before: tuple[range, Video] | None) -> _Prior:
    """The prior of a window; what the window before it made of the frames they share counts as seen."""
    images = prior.images[window.start : window.stop].copy()
    visible = prior.visible[window.start : window.stop].copy()
    if before is not None:
        shared = max(0, before[0].stop - window.start)
        hidden = visible[:shared] == 0.0
        images[:shared][hidden] = before[1][len(before[1]) - shared :][hidden]
        visible[:shared] = 1.0
    return _Prior(images, visible)


def _load_kept(path: Path) -> Tensor | None:
    try:
        return load_file(path)["latents"] if path.is_file() else None
    except (SafetensorError, KeyError):
        return None


def _both(seen: Mask, axis: int) -> Mask:
    """Where neighbours along an axis are both seen."""
    size = seen.shape[axis]
    return np.take(seen, range(1, size), axis) & np.take(seen, range(size - 1), axis)
