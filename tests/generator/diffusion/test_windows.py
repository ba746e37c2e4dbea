"""Windows over long clips, and decoding in tiles."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from olt_generator.diffusion.backbone import build_autoencoder
from olt_generator.diffusion.config import CONFIGS
from olt_generator.diffusion.latents import LatentCodec
from olt_generator.diffusion.tiled_decoding import decode_needed
from olt_generator.diffusion.windows import blend_windows, plan_windows, seam_ratio
from olt_generator.errors import InputError


@given(st.integers(1, 400), st.integers(1, 12), st.integers(0, 3))
def test_windows_cover_a_clip_of_any_length(frames, latents, shared):
    longest, overlap = 4 * latents + 1, 4 * min(shared, latents - 1) + 1
    windows = plan_windows(frames, longest, overlap)
    assert sorted({frame for window in windows for frame in window}) == list(range(frames))
    lengths = {len(window) for window in windows}
    assert len(lengths) == 1
    assert lengths.pop() % 4 == 1
    if frames >= 5:
        assert all(before.stop > after.start > before.start for before, after in pairwise(windows))
    # All but the last start on a whole latent frame.
    assert all(window.start % 4 == 0 for window in windows[:-1] if frames >= 5)


def test_a_window_that_the_autoencoder_cannot_take_is_refused():
    with pytest.raises(InputError, match="40 frames"):
        plan_windows(100, 40)
    with pytest.raises(InputError, match="fewer to share"):
        plan_windows(100, 9, 9)


def test_windows_fade_into_one_another():
    windows = plan_windows(13, 9, 5)
    assert windows == (range(9), range(4, 13))
    low, high = np.zeros((9, 2, 2, 3), np.uint8), np.full((9, 2, 2, 3), 120, np.uint8)
    assert blend_windows([low, high], windows)[:, 0, 0, 0].tolist() == [0] * 4 + [20, 40, 60, 80, 100] + [120] * 4


def test_a_seam_shows_in_its_measure():
    windows = plan_windows(13, 9, 5)
    even = np.arange(13, dtype=np.uint8)[:, None, None, None] * np.ones((1, 2, 2, 3), np.uint8)
    jump = even + np.where(np.arange(13) >= 6, 100, 0).astype(np.uint8)[:, None, None, None]
    assert seam_ratio(even, windows) == 1.0
    assert (seam_ratio(jump, windows) or 0.0) > 10.0
    assert seam_ratio(even, (range(13),)) is None


@pytest.fixture(scope="module")
def codec():
    torch.manual_seed(0)
    return LatentCodec(build_autoencoder(CONFIGS["tiny"].autoencoder))


def test_a_tile_that_nobody_looks_at_is_left_out_and_changes_no_other(codec):
    latents = torch.randn(1, 16, 2, 8, 12, generator=torch.Generator().manual_seed(1))
    everything, some = np.ones((64, 96), bool), np.zeros((64, 96), bool)
    some[40:50, 60:70] = True
    whole, part = (decode_needed(codec, latents, needed, 32) for needed in (everything, some))
    assert whole.left_out == 0 < part.left_out < part.tiles == whole.tiles
    assert np.array_equal(whole.video[:, some], part.video[:, some])
    assert not np.array_equal(whole.video, part.video)


def test_without_tiles_it_is_the_whole_image(codec):
    latents = torch.randn(1, 16, 2, 8, 12, generator=torch.Generator().manual_seed(1))
    decoded = decode_needed(codec, latents, np.ones((64, 96), bool), None)
    assert np.array_equal(decoded.video, codec.decode(latents)[0].numpy())
    assert decode_needed(codec, latents, np.zeros((64, 96), bool), None).left_out == 1
    with pytest.raises(InputError, match="multiple of 16"):
        decode_needed(codec, latents, np.ones((64, 96), bool), 40)
