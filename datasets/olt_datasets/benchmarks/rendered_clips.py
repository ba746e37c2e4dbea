"""Rendered clips that nothing is wrong with: hard drives filmed by the four policy cameras, with effects of cameras."""

from dataclasses import replace
from pathlib import Path

from olt_closed_loop.hard_clips.kinds import specify_clip
from olt_closed_loop.hard_clips.staging import stage_scene
from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_closed_loop.sensors.recorder import record_drive
from olt_toolkit.clips.builder import build_clip
from olt_toolkit.clips.clip import Clip, make_clip_id
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import POLICY_CAMERAS

HARD_KINDS = (
    "turn",
    "traffic",
    "night",
    "stop_and_go",
    "rain",
    "hills",
    "low_sun",
    "compression",
    "rolling_shutter",
    "blur",
    "standstill",
)
KINDS = tuple(name for pair in zip(HARD_KINDS, (*CATEGORIES, *CATEGORIES), strict=False) for name in pair)
"""Kinds of hard clips and categories of scenes, in turn."""

_WIDTH, _HEIGHT, _RATE = 480, 270, 10.0
_SECONDS = 8.0


def write_rendered_store(root: Path, number: int, seed: int) -> ClipStore:
    """A store of two rendered clips, of which the second is of another kind."""
    store = ClipStore(root)
    clips = [make_rendered_clip(each, seed) for each in (2 * number, 2 * number + 1)]
    for clip in clips:
        store.prepare(clip)
    store.commit([clip.clip_id for clip in clips])
    return store


def make_rendered_clip(number: int, seed: int) -> Clip:
    """The clip of that number; each depends on number and seed alone."""
    kind = KINDS[number % len(KINDS)]
    name = f"{kind}_{number:04d}"
    options = BuildOptions(width=_WIDTH, height=_HEIGHT, use_reference_views=True, frames="all", name=name)
    return replace(build_clip(_film(kind, number, seed), options).clip, clip_id=make_clip_id("rendered", seed, number))


def _film(kind: str, number: int, seed: int) -> Recording:
    window_us = (0, round(_SECONDS * 1e6))
    if kind in CATEGORIES:
        scene = generate_scene(kind, 1_000_000 * seed + number)
        return record_drive(scene, _WIDTH, _HEIGHT, _RATE, POLICY_CAMERAS, window_us=window_us)
    asked = specify_clip(kind, number, seed)
    # Glass, bonnet and drops are those of the front camera; the others are wiped and see no bonnet.
    effects = {camera: replace(asked.effects, windscreen=None) for camera in POLICY_CAMERAS[:1] + POLICY_CAMERAS[2:]}
    effects[POLICY_CAMERAS[1]] = asked.effects
    return record_drive(
        stage_scene(asked),
        _WIDTH,
        _HEIGHT,
        _RATE,
        POLICY_CAMERAS,
        window_us=window_us,
        conditions=asked.conditions,
        effects=effects,
    )
