"""Scores of stored clips whose views are true, copied, or disturbed."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from olt_generator.errors import InputError
from olt_generator.metrics.image_metrics import psnr
from olt_generator.metrics.matchers import SiftMatcher
from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.benchmarks.street import render_street
from olt_toolkit.clips.clip import CameraStream, EgoMotion, make_clip_id
from olt_toolkit.clips.score import score_against, score_coherence, score_consistency
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.commands.clip import app
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, FRONT_WIDE
from olt_toolkit.rigs.rig_files import pav_rig

CAMERAS = (CROSS_LEFT, FRONT_WIDE, CROSS_RIGHT)
TRUE, COPIED, DISTURBED, FRONT_ONLY = (make_clip_id(name) for name in ("true", "copied", "disturbed", "front only"))


def film(name: str, trajectory: Trajectory, change=lambda image: image) -> CameraStream:
    mounted = pav_rig().fitted(416, 234)[name]
    poses = trajectory.T_world_rig @ mounted.T_rig_camera
    frames = np.stack([change(render_street(mounted.camera, pose)[0]) for pose in poses])
    return CameraStream(frames, trajectory.timestamps_us, 2.0, mounted.camera, mounted.T_rig_camera)


@pytest.fixture(scope="module")
def store(tmp_path_factory, make_clip):
    times_us = 500_000 * np.arange(2)
    trajectory = Trajectory(times_us, planar_pose(6.0 * times_us * 1e-6, 0.0, 0.0))
    true = {name: film(name, trajectory) for name in CAMERAS}
    copied = {name: replace(stream, frames=true[FRONT_WIDE].frames) for name, stream in true.items()}
    darker = {name: replace(stream, frames=stream.frames - stream.frames // 4) for name, stream in true.items()}
    store = ClipStore(tmp_path_factory.mktemp("scored"))
    for clip_id, name, streams in (
        (TRUE, "true", true),
        (COPIED, "copied", copied),
        (DISTURBED, "disturbed", darker),
        (FRONT_ONLY, "front only", {FRONT_WIDE: true[FRONT_WIDE]}),
    ):
        clip = make_clip(
            name,
            clip_id=clip_id,
            streams=streams,
            ego_motion=EgoMotion.from_trajectory(trajectory),
        )
        provenance = {camera: clip.provenance[camera] for camera in streams}
        store.prepare(replace(clip, provenance=provenance))
    store.commit([TRUE, COPIED, DISTURBED, FRONT_ONLY])
    return store


def test_true_views_are_consistent_and_copied_ones_are_not(store):
    shares: list[float] = []
    true = score_consistency(store, TRUE, SiftMatcher(), moments=2, on_progress=shares.append)
    assert true["percent"] > 90.0
    assert [pair["views"] for pair in true["pairs"]] == [[FRONT_WIDE, CROSS_LEFT], [FRONT_WIDE, CROSS_RIGHT]]
    assert true["moments"] == 4
    assert true["moments_without_match"] == 0
    assert true["matches"] == sum(pair["matches"] for pair in true["pairs"])
    assert "SIFT" in true["matcher"]
    assert true["size"] == [832, 480]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert score_consistency(store, COPIED, SiftMatcher(), moments=1)["percent"] < 5.0


def test_a_clip_without_neighbours_has_no_consistency(store):
    with pytest.raises(InputError, match="no two neighbouring views"):
        score_consistency(store, FRONT_ONLY, SiftMatcher(), moments=1)


def test_coherence_falls_with_darkness_and_is_told_for_each_view(store):
    shares: list[float] = []
    true, darker = (score_coherence(store, clip, 2, shares.append) for clip in (TRUE, DISTURBED))
    assert set(true) == {CROSS_LEFT, CROSS_RIGHT}
    for view in true.values():
        assert 0.0 < view["percent"] <= 100.0
        assert view["flicker"] is not None
    assert shares[-1] == 1.0
    # Both views and the front view are darker alike: nothing is incoherent about that.
    assert darker[CROSS_LEFT]["percent"] == pytest.approx(true[CROSS_LEFT]["percent"], rel=0.25)


def test_errors_against_a_reference(store):
    scores = score_against(store, DISTURBED, store, TRUE)
    assert scores["lpips"] is None
    assert set(scores["views"]) == set(CAMERAS)
    view = scores["views"][CROSS_LEFT]
    assert view["size"] == [416, 234]
    assert view["frames"] == 2
    assert view["lpips"] is None
    frames, truth = (store.read_frames(clip_id, CROSS_LEFT, 500_000 * np.arange(2))[0] for clip_id in (DISTURBED, TRUE))
    assert view["psnr"] == pytest.approx(psnr(frames, truth))
    assert 0.5 < view["ssim"] < 1.0
    assert set(score_against(store, FRONT_ONLY, store, TRUE)["views"]) == {FRONT_WIDE}


def test_a_clip_against_itself_is_identical(store):
    views = score_against(store, TRUE, store, TRUE, lpips=Difference())["views"]
    assert {(view["psnr"], view["ssim"], view["lpips"]) for view in views.values()} == {(None, 1.0, 0.0)}


class Difference:
    """Stands for a learned distance."""

    name = "difference"

    def __call__(self, a, b) -> float:
        return float(np.abs(a.astype(int) - b).mean())


def test_clips_are_found_by_name_and_by_id(store, make_clip):
    assert store.find("copied") == store.find(COPIED) == COPIED
    with pytest.raises(InputError, match="no clip 'nothing'"):
        store.find("nothing")
    other = ClipStore(store.root.parent / "twice")
    for seed in (1, 2):
        other.prepare(make_clip("twin", clip_id=make_clip_id("twin", seed)))
    other.commit([make_clip_id("twin", seed) for seed in (1, 2)])
    with pytest.raises(InputError, match="2 clips are called 'twin'"):
        other.find("twin")


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_score_command_prints_both(store):
    arguments = ("score", store.root, "disturbed", "--reference", "true", "--moments", 1)
    result = run(*arguments, "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["clip_id"] == DISTURBED
    assert summary["geokpm"]["moments"] == 2
    assert summary["reference"]["clip_id"] == TRUE
    text = run(*arguments).stdout
    for part in ("GeoKPM with RootSIFT", "832 x 480", "PSNR dB", "LPIPS: not measured"):
        assert part in text


def test_score_command_needs_a_reference_to_compare_with(store, tmp_path):
    assert "--reference is missing" in str(run("score", store.root, "true", "--lpips-weights", tmp_path).exception)


@pytest.mark.slow
def test_score_command_names_missing_weights(store, tmp_path):
    matcher = run("score", store.root, "true", "--loftr-weights", tmp_path / "loftr.ckpt")
    assert "no such weights file" in str(matcher.exception)
    lpips = run("score", store.root, "true", "--reference", "true", "--lpips-weights", tmp_path)
    assert "alexnet-owt" in str(lpips.exception)
