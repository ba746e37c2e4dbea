"""Frames, latent frames and cells against the rule of the released generator."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_generator.errors import InputError
from olt_generator.seeds import make_generator
from olt_generator.views.latents import (
    count_latents,
    frame_of_latent,
    frames_of_latent,
    latent_of_frame,
    visibility_in_latents,
)


@given(st.integers(0, 10_000))
def test_every_frame_lies_in_exactly_its_latent_frame(frame):
    latent = latent_of_frame(frame)
    assert frame in frames_of_latent(latent)
    assert frames_of_latent(latent).stop == frames_of_latent(latent + 1).start


def test_the_clip_of_the_paper():
    assert count_latents(41) == 11
    assert frames_of_latent(0) == range(1)
    assert frames_of_latent(10) == range(37, 41)
    assert [frame_of_latent(3, moment) for moment in ("mean", "last", "lookback")] == [10.5, 12.0, 11.0]
    assert [frame_of_latent(0, moment) for moment in ("mean", "last", "lookback")] == [0.0, 0.0, 0.0]
    assert frame_of_latent(3, "mean") == np.mean(frames_of_latent(3))


def test_cells_are_those_of_torch():
    torch = pytest.importorskip("torch")
    visible = make_generator("visible").random((9, 48, 80)) < 0.4
    cells = torch.nn.functional.interpolate(
        torch.from_numpy(visible[:, None].astype(np.float32)), (6, 10), mode="bilinear", align_corners=False
    )[:, 0].numpy()
    expected = np.stack([cells[0], cells[1:5].max(axis=0), cells[5:9].max(axis=0)])
    latents = visibility_in_latents(visible)
    assert latents.dtype == np.float16
    np.testing.assert_array_equal(latents, expected.astype(np.float16))
    assert len(np.unique(latents)) > 2  # no threshold


def test_full_size():
    latents = visibility_in_latents(np.ones((41, 480, 832), bool))
    assert latents.shape == (11, 60, 104)
    assert np.all(latents == 1.0)


@pytest.mark.parametrize("frames", [0, 2, 40, 44])
def test_frames_that_do_not_fill_latents_are_refused(frames):
    with pytest.raises(InputError, match=f"{frames} frames"):
        count_latents(frames)


def test_pixels_that_do_not_fill_cells_are_refused():
    with pytest.raises(InputError, match="84 x 48"):
        visibility_in_latents(np.ones((1, 48, 84), bool))
