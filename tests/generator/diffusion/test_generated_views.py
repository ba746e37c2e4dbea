"""Algorithm 1 on a clip: order, dependence, resuming, and what of the warp is kept."""

from dataclasses import replace

import numpy as np
import pytest

from olt_generator.diffusion import generated_views
from olt_generator.diffusion.backend import WanVaceBackend
from olt_generator.diffusion.generation import GenerationSettings, draw_noise
from olt_generator.errors import InputError
from olt_generator.views.backend import GeometricBackend
from olt_generator.views.pixel_origin import PixelOrigin

from .tiny_engine import (
    CROSS_LEFT,
    CROSS_RIGHT,
    FACTS,
    REAR_LEFT,
    REAR_RIGHT,
    REAR_TELE,
    TARGETS,
    street,
    without_memory,
    write_engine,
)

QUICK = GenerationSettings(steps=2)
FRAMES = 5


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_engine(tmp_path_factory.mktemp("engine") / "tiny")


def start(folder, settings=QUICK, frames=FRAMES, seed=0, keep=None, **changes):
    backend = WanVaceBackend(folder, settings=settings, keep=keep)
    return backend.start(street(frames), TARGETS, range(frames), seed, **changes)


@pytest.fixture
def sampled(monkeypatch):
    """Ids of the views that were sampled, in order."""
    views, sample = [], generated_views.sample_view

    def note(engine, view, *arguments):
        views.append(view)
        return sample(engine, view, *arguments)

    monkeypatch.setattr(generated_views, "sample_view", note)
    return views


def test_only_what_is_asked_for_and_what_it_depends_on_is_sampled(folder, sampled):
    start(folder).make(REAR_LEFT)
    assert sampled == [1, 3]
    assert WanVaceBackend(folder).needed([REAR_LEFT]) == (CROSS_LEFT, REAR_LEFT)
    assert WanVaceBackend(folder).needed([REAR_TELE]) == tuple(TARGETS)


def test_the_order_of_asking_changes_nothing(folder):
    names = [CROSS_LEFT, CROSS_RIGHT, REAR_LEFT]
    forwards, backwards = start(folder), start(folder)
    first = {name: forwards.make(name) for name in names}
    second = {name: backwards.make(name) for name in names[::-1]}
    for name in names:
        assert np.array_equal(first[name].images, second[name].images)
    assert np.array_equal(first[REAR_LEFT].images, forwards.make(REAR_LEFT).images)


def test_a_view_depends_on_its_conditions_and_seed(folder):
    plain = start(folder).make(REAR_LEFT).images
    fewer = start(folder, replace(QUICK, conditions=1)).make(REAR_LEFT).images
    none = start(folder, replace(QUICK, conditions=0)).make(REAR_LEFT).images
    other = start(folder, seed=1).make(REAR_LEFT).images
    different = [plain, fewer, none, other]
    assert all(not np.array_equal(a, b) for i, a in enumerate(different) for b in different[:i])


def test_without_memory_no_other_view_is_sampled(tmp_path, sampled):
    folder = write_engine(tmp_path / "engine", without_memory())
    assert WanVaceBackend(folder).needed([REAR_TELE]) == (REAR_TELE,)
    start(folder).make(REAR_TELE)
    assert sampled == [5]


def test_what_the_front_camera_saw_stays_as_the_geometric_engine_warps_it(folder):
    front = street(FRAMES)
    warped = GeometricBackend().start(front, TARGETS, range(FRAMES), 0).make(CROSS_LEFT)
    made = start(folder).make(CROSS_LEFT)
    seen = warped.origin != PixelOrigin.INVENTED
    assert 0.02 < seen.mean() < 0.98
    assert np.array_equal(made.origin, warped.origin)
    assert np.array_equal(made.images[seen], warped.images[seen])
    assert not np.array_equal(made.images[~seen], warped.images[~seen])
    everything = start(folder, replace(QUICK, keep_observed=False)).make(CROSS_LEFT)
    assert not np.array_equal(everything.images[seen], warped.images[seen])
    assert set(np.unique(everything.origin)) <= {PixelOrigin.INVENTED, *np.unique(warped.origin)}
    assert (everything.origin == PixelOrigin.INVENTED).mean() > 0.9


@pytest.mark.parametrize("frames", [1, 2, 6, 13])
def test_clips_of_any_length(folder, frames):
    settings = replace(QUICK, steps=1, window=9, overlap=5)
    view = start(folder, settings, frames).make(CROSS_RIGHT)
    assert view.images.shape == (frames, 32, 48, 3)


def test_what_is_seen_where_windows_meet_hides_nothing_elsewhere(folder, monkeypatch):
    """A window whose last frames are seen whole is decoded all the same for the frames before."""
    settings = replace(QUICK, steps=1, window=9, overlap=1)
    plain = start(folder, settings, 9).make(CROSS_LEFT)
    prior = generated_views.warp_prior

    def see_the_end(images, origin, fill):
        shown, visible = prior(images, origin, fill)
        visible[8:] = 1.0
        return shown, visible

    monkeypatch.setattr(generated_views, "warp_prior", see_the_end)
    long = start(folder, settings, 13).make(CROSS_LEFT)
    black = (long.images[:8] == 0).all(axis=-1).mean()
    assert black < 0.05 + (plain.images[:8] == 0).all(axis=-1).mean()


def test_windows_share_the_noise_of_what_they_share():
    whole = draw_noise(3, 1, 0, (6, 4, 6), 0.5)
    assert np.array_equal(whole[:, :, 2:], draw_noise(3, 1, 2, (4, 4, 6), 0.5))
    other = draw_noise(3, 2, 0, (6, 4, 6), 0.5)
    samples = np.stack([draw_noise(3, view, 0, (40, 16, 16), 0.5).numpy().ravel() for view in (1, 2)])
    assert np.corrcoef(samples)[0, 1] == pytest.approx(0.25, abs=0.01)
    assert samples.std() == pytest.approx(1.0, abs=0.01)
    assert not np.array_equal(whole, other)
    assert np.array_equal(draw_noise(3, 1, 0, (6, 4, 6), 1.0), draw_noise(3, 2, 0, (6, 4, 6), 1.0))


class Killed(Exception):
    """The run ends here."""


def test_a_killed_run_goes_on_with_what_it_has(folder, tmp_path, sampled, monkeypatch):
    whole = start(folder).make(REAR_LEFT)
    sampled.clear()
    sample = generated_views.sample_view

    def die(engine, view, *arguments):
        if view == 3:
            raise Killed
        return sample(engine, view, *arguments)

    monkeypatch.setattr(generated_views, "sample_view", die)
    with pytest.raises(Killed):
        start(folder, keep=tmp_path).make(REAR_LEFT)
    assert sampled == [1]
    monkeypatch.setattr(generated_views, "sample_view", sample)
    again = start(folder, keep=tmp_path).make(REAR_LEFT)
    assert sampled == [1, 3]
    assert np.array_equal(again.images, whole.images)
    # Another seed, or a file that is damaged, is made again.
    start(folder, keep=tmp_path, seed=1).make(CROSS_LEFT)
    for path in tmp_path.iterdir():
        path.write_bytes(path.read_bytes()[:-5])
    start(folder, keep=tmp_path).make(CROSS_LEFT)
    assert sampled == [1, 3, 1, 1]


def test_tiles_that_are_observed_are_left_out_and_the_view_is_the_same(tmp_path, monkeypatch):
    large = write_engine(tmp_path / "engine", replace(FACTS, width=192, height=128))
    settings = GenerationSettings(steps=1, cross_guidance=1.0, tile=16)
    source = start(large, settings, 1)
    view = source.make(CROSS_LEFT)
    monkeypatch.setattr(generated_views, "needed_pixels", lambda looked_at, margin: np.ones_like(looked_at))
    everything = start(large, settings, 1)
    assert np.array_equal(view.images, everything.make(CROSS_LEFT).images)
    left_out = [omission for omission in source.left_out() if omission.what.startswith("tiles")]
    assert left_out
    assert 0 < (left_out[0].count or 0) < (left_out[0].total or 0)
    assert not any(omission.what.startswith("tiles") for omission in everything.left_out())


def test_half_precision_is_near(folder):
    single = WanVaceBackend(folder, settings=QUICK).start(street(FRAMES), TARGETS, range(FRAMES), 0).make(CROSS_LEFT)
    half = WanVaceBackend(folder, settings=QUICK, precision="bfloat16")
    other = half.start(street(FRAMES), TARGETS, range(FRAMES), 0).make(CROSS_LEFT)
    error = np.abs(single.images.astype(int) - other.images).mean()
    assert 0.0 < error < 10.0


def test_notes_tell_what_is_not_as_in_training(folder, tmp_path):
    assert not any("trained" in note for note in start(folder).make(CROSS_LEFT).notes)
    other = write_engine(tmp_path / "engine", replace(FACTS, frame_us=33_333))
    assert any("33.3 ms between frames, and here are 100" in note for note in start(other).make(CROSS_LEFT).notes)


def test_guidance_of_one_is_one_pass(folder):
    source = start(folder, replace(QUICK, cross_guidance=1.0))
    source.make(CROSS_LEFT)
    assert [omission.what for omission in source.left_out()] == ["passes without the prompt"]


@pytest.mark.parametrize("wrong", [{"steps": 0}, {"shared_noise": 1.5}, {"conditions": 4}, {"rear_guidance": np.inf}])
def test_settings_outside_of_their_range_are_refused(wrong):
    with pytest.raises(InputError):
        GenerationSettings(**wrong)


def test_rear_right_follows_from_cross_right(folder, sampled):
    start(folder).make(REAR_RIGHT)
    assert sampled == [2, 4]
