"""Scores of generated views: kept pixels, what is measured and what is not."""

import numpy as np
import pytest

from olt_generator.diffusion.backbone import build_autoencoder
from olt_generator.diffusion.conditioned_model import build_model
from olt_generator.diffusion.engine_folder import EngineFacts, load_engine, save_engine
from olt_generator.diffusion.evaluation import sample_views, score_views
from olt_generator.diffusion.observed_pixels import keep_observed

from . import toy_cache


def test_the_truth_scores_best_and_kept_pixels_are_those_of_the_warp():
    _, videos = toy_cache.draw_clip(1)
    scores = score_views(videos, {1: videos.truth[1], 3: videos.filled[3]})
    assert [score.view for score in scores] == ["camera_cross_left_120fov", "camera_rear_left_70fov"]
    assert scores[0].psnr == float("inf") and scores[0].ssim == pytest.approx(1.0)
    assert scores[1].psnr == scores[1].geometric_psnr
    assert scores[1].invented_psnr == scores[1].geometric_invented_psnr
    share = ((videos.origin[3] == 0) & videos.known[3]).sum() / (5 * videos.known[3].sum())
    assert scores[1].invented == pytest.approx(share)
    assert scores[0].lpips is None and scores[0].geokpm is None


def test_what_was_seen_is_kept_and_the_rest_fades_into_it():
    generated, warped = np.full((1, 4, 288, 3), 200, np.uint8), np.zeros((1, 4, 288, 3), np.uint8)
    free = np.zeros((1, 4, 288), bool)
    free[..., 144:] = True
    kept = keep_observed(generated, warped, free)
    assert kept[0, 2, 140:150, 0].tolist() == [0, 0, 0, 0, 50, 100, 150, 200, 200, 200]
    np.testing.assert_array_equal(keep_observed(generated, warped, ~np.zeros_like(free)), generated)
    np.testing.assert_array_equal(keep_observed(generated, warped, np.zeros_like(free)), warped)


def test_all_views_are_sampled_and_alike_for_a_seed(tmp_path):
    model, autoencoder = build_model(toy_cache.ENGINE), build_autoencoder(toy_cache.ENGINE.autoencoder)
    save_engine(
        tmp_path / "engine",
        EngineFacts(toy_cache.ENGINE, 48, 32, 100_000, owns_backbone=True),
        model,
        autoencoder,
        *toy_cache.build_texts(),
    )
    engine = load_engine(tmp_path / "engine")
    clip, _ = toy_cache.draw_clip(1)
    made = sample_views(engine, clip, (1, 2, 3, 4, 5), 1, seed=0)
    assert {view: video.shape for view, video in made.items()} == dict.fromkeys(range(1, 6), (5, 32, 48, 3))
    again = sample_views(engine, clip, (1,), 1, seed=0)
    np.testing.assert_array_equal(again[1], made[1])
