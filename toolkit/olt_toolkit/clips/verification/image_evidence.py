"""What the images of one camera say for and against what a clip says of them, step by step."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.poses import Array, invert
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.verification.flow_likelihood import (
    distance_weights,
    log_likelihood,
    odds_on_lens,
    place_spread,
)
from olt_toolkit.clips.verification.image_steps import ImageSteps
from olt_toolkit.rigs.rig import MountedCamera

Times = NDArray[np.int64]
Poses = Array


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What might be true of a camera's images and the ego motion; all defaults are what the clip says.

    Attributes:
        times: from what the clip says (m,) to the true clip times (m,) of the images.
        motion: from what the clip says to the true rig poses (m, 4, 4) at clip times (m,).
        camera: whose images they are; None for the one that they are said to be of.
        mirrored: whether the images are mirrored left to right.
        span_us: clip times that the true motion covers; None for those that the clip's does.
    """

    times: Callable[[Times], Times] = lambda times_us: times_us
    motion: Callable[[Callable[[Times], Poses], Times], Poses] = lambda poses, times_us: poses(times_us)
    camera: MountedCamera | None = None
    mirrored: bool = False
    span_us: tuple[int, int] | None = None

    @property
    def is_said_view(self) -> bool:
        """Whether camera and images are what the clip says."""
        return self.camera is None and not self.mirrored


AS_SAID = Hypothesis()


@dataclass(frozen=True)
class _View:
    """The points as one camera sees them: its mounting, rays (n, 3), and what `log_likelihood` takes."""

    T_rig_camera: Array
    rays: Array
    moved: Array
    weights: NDArray[np.float32]
    spread: Array


class ImageEvidence:
    """The evidence of one camera's images under any hypothesis."""

    def __init__(self, steps: ImageSteps, ego_motion: EgoMotion) -> None:
        self.steps, self.ego_motion = steps, ego_motion
        way = np.linalg.norm(steps.moved - steps.pixels, axis=1)
        self._pixel_spread = place_spread(way, _magnification(steps.images.lens))
        self._stays = odds_on_lens(way)

    def thinned(self, steps: int, points: int) -> "ImageEvidence":
        """The same of one in so many steps and one in so many of their points."""
        old = self.steps
        kept_steps = np.arange(0, len(old.first), steps)
        number = np.full(len(old.first), -1)
        number[kept_steps] = np.arange(len(kept_steps))
        kept = np.flatnonzero(number[old.step] >= 0)[::points]
        return ImageEvidence(
            ImageSteps(
                old.images,
                old.first[kept_steps],
                old.second[kept_steps],
                number[old.step[kept]],
                old.pixels[kept],
                old.moved[kept],
            ),
            self.ego_motion,
        )

    def of(self, hypothesis: Hypothesis) -> Array:
        """Log-likelihood (n,) of each point; NaN where the motion does not cover its step."""
        first_us, second_us = self._step_times(hypothesis)
        low, high = hypothesis.span_us or self.ego_motion.span_us
        known = (np.minimum(first_us, second_us) >= low) & (np.maximum(first_us, second_us) <= high)
        before, after = np.split(hypothesis.motion(self._poses, np.concatenate([first_us, second_us])), 2)
        likelihood = self.of_motion(invert(before) @ after, hypothesis)
        return np.where(known[self.steps.step], likelihood, np.nan)

    def of_motion(self, T_before_after: Poses, hypothesis: Hypothesis = AS_SAID) -> Array:
        """The same (n,) for rig poses (s, 4, 4) after each step in the rig before it."""
        view = self._view if hypothesis.is_said_view else self._seen_by(hypothesis)
        T_rig_camera = view.T_rig_camera
        camera_steps = invert(T_rig_camera) @ T_before_after @ T_rig_camera
        return log_likelihood(
            view.rays, view.moved, camera_steps[self.steps.step], view.weights, view.spread, self._stays
        )

    @cached_property
    def _view(self) -> "_View":
        return self._seen_by(AS_SAID)

    def _seen_by(self, hypothesis: Hypothesis) -> "_View":
        steps, images = self.steps, self.steps.images
        mounted = hypothesis.camera or MountedCamera(images.lens, images.T_rig_camera)
        lens = mounted.camera.resized(images.lens.width, images.lens.height)
        rays, moved = (_rays(lens, pixels, hypothesis.mirrored) for pixels in (steps.pixels, steps.moved))
        spread = np.stack([self._pixel_spread / _magnification(lens), self._pixel_spread], axis=1)
        rotation, height = mounted.T_rig_camera[:3, :3], float(mounted.T_rig_camera[2, 3])
        return _View(mounted.T_rig_camera, rays, moved, distance_weights(rays @ rotation.T, height), spread)

    def _step_times(self, hypothesis: Hypothesis) -> tuple[Times, Times]:
        times_us = hypothesis.times(self.steps.images.times_us)
        return times_us[self.steps.first], times_us[self.steps.second]

    def _poses(self, times_us: Times) -> Poses:
        low, high = self.ego_motion.span_us
        return self.ego_motion.interpolate(np.clip(times_us, low, high))


def _rays(lens: Camera, pixels: Array, mirrored: bool) -> Array:
    if mirrored:
        pixels = np.stack([lens.width - 1 - pixels[:, 0], pixels[:, 1]], axis=1)
    return lens.rays(pixels)


def _magnification(lens: Camera) -> float:
    """Pixels per radian in the middle of the image, mean of both directions."""
    return float(np.mean(lens.pixels_per_radian))
