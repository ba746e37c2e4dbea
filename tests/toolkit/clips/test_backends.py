"""Clips whose views a learned backend made, beside those of the geometric one."""

import json
from dataclasses import replace

import numpy as np
import pytest

from olt_generator.diffusion.backend import WanVaceBackend
from olt_generator.diffusion.generation import GenerationSettings
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.clips.backends import Backends
from olt_toolkit.clips.build_options import describe_build
from olt_toolkit.clips.builder import build_clip
from olt_toolkit.clips.estimators import Estimators
from olt_toolkit.clips.identity import clip_id_of
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.recordings.recording import OpenOptions, Recording
from olt_toolkit.rigs.contracts import CONTRACTS
from olt_toolkit.rigs.names import Backend
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, DEFAULT_VEHICLE, POLICY_CAMERAS, REAR_LEFT, REAR_TELE
from olt_toolkit.rigs.rig_files import pav_rig

from ...generator.diffusion.tiny_engine import write_engine

FRAMES = 5
OPTIONS = BuildOptions(width=64, height=36, frames="all", use_reference_motion=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_engine(tmp_path_factory.mktemp("engine") / "tiny")


@pytest.fixture(scope="module")
def recording():
    """Half a second of noise at 8 m from a moving camera."""
    front = pav_rig().fitted(64, 36)["camera_front_wide_120fov"]
    times_us = 100_000 * np.arange(FRAMES, dtype=np.int64)
    frames = make_generator("recording").integers(0, 256, (FRAMES, 36, 64, 3), dtype=np.uint8)
    return Recording(
        name="noise",
        source="test",
        frames=frames,
        timestamps_us=times_us,
        camera=front.camera,
        T_rig_camera=camera_pose_in_rig([1.7, 0.0, 1.5], 0.0, 0.0, 0.0),
        vehicle=DEFAULT_VEHICLE,
        reference=Trajectory(times_us, planar_pose(0.5 * np.arange(FRAMES), 0.0, 0.0)),
    )


def build(recording, folder=None, cameras=POLICY_CAMERAS, **changes):
    options = replace(OPTIONS, cameras=cameras, **changes)
    if folder is not None:
        options = replace(options, backend=WanVaceBackend(folder, settings=GenerationSettings(steps=1)))
    return build_clip(recording, options)


@pytest.fixture(scope="module")
def both(recording, folder):
    return build(recording), build(recording, folder)


def test_a_policy_cannot_tell_by_the_form_which_backend_made_its_views(both):
    warped, generated = both
    assert warped.clip.streams.keys() == generated.clip.streams.keys()
    for name, stream in warped.clip.streams.items():
        other = generated.clip.streams[name]
        assert (stream.frames.shape, stream.frames.dtype) == (other.frames.shape, other.frames.dtype)
        assert stream.camera == other.camera
        assert np.array_equal(stream.T_rig_camera, other.T_rig_camera)


def test_what_was_seen_is_the_same_and_what_is_invented_is_not(both):
    warped, generated = (each.clip.streams[CROSS_LEFT] for each in both)
    assert warped.origin is not None
    seen = warped.origin != PixelOrigin.INVENTED
    assert seen.any()
    assert np.array_equal(warped.origin, generated.origin)
    assert np.array_equal(warped.frames[seen], generated.frames[seen])
    assert not np.array_equal(warped.frames, generated.frames)


def test_the_clip_tells_who_made_its_views(both, folder):
    warped, generated = (each.clip for each in both)
    assert warped.clip_id != generated.clip_id
    made = generated.provenance[CROSS_RIGHT]
    assert (made.kind, made.seed) == ("generated", 0)
    assert made.engine == WanVaceBackend(folder).engine
    assert warped.provenance[CROSS_RIGHT].kind == "warped"


def test_both_clips_fit_into_one_store(both, tmp_path):
    store = ClipStore(tmp_path)
    for built in both:
        store.prepare(built.clip)
    store.commit([built.clip.clip_id for built in both])
    kinds = {info.views[CROSS_LEFT].kind for info in ClipStore(tmp_path).clips()}
    assert kinds == {"warped", "generated"}


def test_helpers_are_made_and_not_told_as_left_out(recording, folder):
    built = build(recording, folder, cameras=("camera_front_wide_120fov", REAR_LEFT))
    assert set(built.clip.streams) == {"camera_front_wide_120fov", REAR_LEFT}
    left_out = {omission.what for omission in built.left_out}
    assert CROSS_RIGHT in left_out
    assert CROSS_LEFT not in left_out


@pytest.mark.parametrize(("contract", "views"), [("alpamayo-r1", 2), ("alpamayo-1.5", 2), ("alpamayo-2", 4)])
def test_plans_by_name_synthesize_what_the_policy_eats(folder, contract, views):
    wanted = [name for name in CONTRACTS[contract].cameras if "front" not in name]
    needed = WanVaceBackend(folder).needed(wanted)
    assert set(needed) == set(wanted)
    assert len(needed) == views
    assert REAR_TELE not in needed


def test_a_backend_is_part_of_the_id_where_it_makes_views():
    def ids(kind):
        return {clip_id_of("s", "", (0, 1), kind, backend=backend.value) for backend in Backend}

    assert len(ids("Syn")) == 2
    assert len(ids("GT")) == len(ids("front_only")) == 1
    assert clip_id_of("s", "", (0, 1), "Syn", backend="geometric") == clip_id_of("s", "", (0, 1), "Syn")


def test_options_of_the_engine_are_told_with_it_alone(folder):
    def describe(backends):
        return json.loads(describe_build(OPTIONS, Estimators(), OpenOptions(), True, backends))

    plain, learned = describe(Backends()), Backends(Backend.WAN_VACE, folder, steps=7)
    assert "steps" not in plain
    assert describe(learned)["steps"] == 7
    assert describe(learned) != describe(replace(learned, keep_observed=False))


@pytest.mark.parametrize("given", [{"steps": 3}, {"keep_observed": False}, {"tile": 64}, {"guidance": 1.0}])
def test_options_of_another_backend_are_refused(given):
    with pytest.raises(InputError, match="is of --backend wan-vace"):
        Backends(**given)


def test_a_learned_backend_needs_its_weights(tmp_path):
    with pytest.raises(InputError, match="--generator-weights"):
        Backends(Backend.WAN_VACE)
    with pytest.raises(InputError, match="no such file"):
        Backends(Backend.WAN_VACE, tmp_path).open()
