"""Masks in a store: written beside the public tree, read back, held against the clip table."""

import zipfile
from dataclasses import replace

import numpy as np
import pytest

from olt_generator.errors import InputError
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.clips.clip import ViewProvenance, make_clip_id
from olt_toolkit.clips.files import check_clip
from olt_toolkit.clips.origin_files import encode_origin
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.summary import summarize_stored
from olt_toolkit.policy.sample import SampleKey
from olt_toolkit.rigs.contracts import find_contract
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, FRONT_WIDE, REAR_LEFT, REAR_RIGHT

CLIP = make_clip_id("bend")
MASKS = f"pixel_origin/{CROSS_LEFT}.pixel_origin/{CROSS_LEFT}.pixel_origin.chunk_0000.zip"


def masked(clip, camera, origin):
    """The clip with the masks (n, 72, 128) of one camera."""
    streams = clip.streams | {camera: replace(clip.streams[camera], origin=origin)}
    view = ViewProvenance("warped", "test", "1", 0, 0.0, 1.0).with_shares(origin)
    return replace(clip, streams=streams, provenance=clip.provenance | {camera: view})


def growing_masks(count):
    """Of frame k the left k columns are seen, the first row at other moments, and the rest is invented."""
    masks = np.full((count, 72, 128), PixelOrigin.INVENTED, np.uint8)
    for number, mask in enumerate(masks):
        mask[:, :number], mask[0, :number] = PixelOrigin.SAME_FRAME, PixelOrigin.OTHER_FRAME
    return masks


@pytest.fixture(scope="module")
def clip(make_clip):
    whole = make_clip()
    return masked(whole, CROSS_LEFT, growing_masks(len(whole.streams[CROSS_LEFT].frames)))


@pytest.fixture
def store(clip, make_clip, tmp_path):
    store = ClipStore(tmp_path / "clips")
    for each in (clip, make_clip("other")):
        store.prepare(each)
    store.commit([clip.clip_id, make_clip_id("other")])
    return store


def test_masks_of_frames_come_back(store, clip):
    times_us = clip.streams[CROSS_LEFT].timestamps_us
    np.testing.assert_array_equal(store.read_origin(CLIP, CROSS_LEFT, times_us), clip.streams[CROSS_LEFT].origin)
    between = times_us[[3, 40]] + 99_999
    np.testing.assert_array_equal(store.read_origin(CLIP, CROSS_LEFT, between), growing_masks(90)[[3, 40]])
    whole = store.read_origin(CLIP, FRONT_WIDE, np.array([0, 100_000]))
    assert whole.shape == (2, 72, 128)
    assert (whole == PixelOrigin.SAME_FRAME).all()
    with pytest.raises(InputError, match="was asked for"):
        store.read_origin(CLIP, CROSS_LEFT, np.array([99_000_000]))


def test_shares_of_masks_are_those_of_the_clip_table(store):
    view = store.info(CLIP).views[CROSS_LEFT]
    origin = store.read_origin(CLIP, CROSS_LEFT, store.read_timestamps(CLIP, CROSS_LEFT))
    assert view.observed_share == pytest.approx((origin != PixelOrigin.INVENTED).mean())
    assert view.other_times_share == pytest.approx((origin == PixelOrigin.OTHER_FRAME).mean())
    assert view.invented_share == pytest.approx((origin == PixelOrigin.INVENTED).mean())
    summary = summarize_stored(store, CLIP)
    assert summary["cameras"][CROSS_LEFT]["frames_not_seen"] == 1
    assert summary["clip"]["views"][CROSS_LEFT]["unseen_share"] == 0.0


def test_only_views_that_were_not_seen_whole_have_masks(store):
    assert sorted(path.name for path in (store.root / "pixel_origin").iterdir()) == [f"{CROSS_LEFT}.pixel_origin"]
    with zipfile.ZipFile(store.root / MASKS) as archive:
        assert archive.namelist() == [f"{CLIP}.{CROSS_LEFT}.pixel_origin.parquet"]
    assert "pixel_origin" not in (store.root / "features.csv").read_text()


def test_samples_carry_masks_where_they_are_asked_for(store):
    key = SampleKey(str(store.root), CLIP, 2_000_000)
    assert store.load_sample(key).image_origin is None
    origin = store.load_sample(key, with_origin=True).image_origin
    assert origin.shape == (4, 4, 72, 128)
    # Frames 16 to 19 of cross-left, and the whole other cameras.
    np.testing.assert_array_equal(origin[0], growing_masks(90)[16:20])
    assert (origin[1:] == PixelOrigin.SAME_FRAME).all()
    small = store.load_sample(key, (36, 64), with_origin=True).image_origin
    assert small.shape == (4, 4, 36, 64)
    assert (small[0] == PixelOrigin.SAME_FRAME).mean() == pytest.approx(
        (origin[0] == PixelOrigin.SAME_FRAME).mean(), abs=0.02
    )


def rewrite(store, change):
    path = store.root / MASKS
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            changed = change(data)
            if changed is not None:
                archive.writestr(name, changed)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: None, "is missing; build the clip again"),
        (lambda data: b"text", "not a readable Parquet file"),
        (lambda data: encode_origin(np.arange(90), growing_masks(90)), "has not the times of the video's frames"),
        (lambda data: encode_origin(81_000 + 100_000 * np.arange(90), growing_masks(90)[:, 1:]), "masks of 128 x 71"),
        (lambda data: encode_origin(81_000 + 100_000 * np.arange(90), 0 * growing_masks(90)), "other shares of pixels"),
    ],
)
def test_masks_that_do_not_belong_to_the_clip_are_refused(store, change, message):
    store.check(CLIP, (2_000_000,))
    rewrite(store, change)
    broken = ClipStore(store.root)
    for read in (
        lambda: broken.check(CLIP, (2_000_000,)),
        lambda: broken.read_origin(CLIP, CROSS_LEFT, np.array([500_000])),
        lambda: summarize_stored(broken, CLIP),
    ):
        with pytest.raises(InputError, match=message) as error:
            read()
        assert MASKS.rpartition("/")[-1] in str(error.value)
    broken.check(make_clip_id("other"), (2_000_000,))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda stream: replace(stream, origin=None), "was not seen whole, but which pixels were is not told"),
        (lambda stream: replace(stream, origin=stream.origin[1:]), "origin is"),
        (lambda stream: replace(stream, origin=stream.origin.astype(int)), "origin is"),
        (lambda stream: replace(stream, origin=stream.origin + np.uint8(4)), "which is no PixelOrigin"),
        (lambda stream: replace(stream, origin=0 * stream.origin), "shares of its provenance are not those"),
    ],
)
def test_clips_whose_masks_contradict_them_are_refused(clip, change, message):
    broken = replace(clip, streams=clip.streams | {CROSS_LEFT: change(clip.streams[CROSS_LEFT])})
    with pytest.raises(InputError, match=f"clip bend: {CROSS_LEFT}.*{message}"):
        check_clip(broken)


def test_black_borders_are_no_part_of_the_fingerprint(make_clip, tmp_path):
    """The same pictures in a frame of black, which alone would make any two drives look alike."""
    clip = make_clip()
    front = clip.streams[FRONT_WIDE]
    frames = np.random.default_rng(0).integers(0, 255, front.frames.shape, np.uint8)
    framed = frames.copy()
    origin = np.full(front.frames.shape[:3], PixelOrigin.SAME_FRAME, np.uint8)
    origin[:, :20], origin[:, :, :40] = PixelOrigin.UNSEEN, PixelOrigin.UNSEEN
    framed[origin == PixelOrigin.UNSEEN] = 0
    bordered = masked(
        replace(clip, streams=clip.streams | {FRONT_WIDE: replace(front, frames=framed)}), FRONT_WIDE, origin
    )
    part = replace(clip.streams[FRONT_WIDE], frames=frames[:, 20:, 40:], camera=front.camera.cropped(40, 20, 88, 52))
    alone = replace(clip, streams=clip.streams | {FRONT_WIDE: part})
    store = ClipStore(tmp_path)
    assert store.prepare(bordered).fingerprint == store.prepare(alone).fingerprint


def test_six_cameras_give_samples_of_six(make_clip, tmp_path):
    clip, two = make_clip(), find_contract("alpamayo-2")
    views = {REAR_LEFT: CROSS_LEFT, REAR_RIGHT: CROSS_RIGHT}
    six = replace(
        clip,
        streams=clip.streams | {rear: clip.streams[cross] for rear, cross in views.items()},
        provenance=clip.provenance | {rear: clip.provenance[cross] for rear, cross in views.items()},
    )
    store = ClipStore(tmp_path)
    info = store.prepare(six)
    store.commit([six.clip_id])
    assert info.sample_t0_us
    key = SampleKey(str(tmp_path), CLIP, info.sample_t0_us[0])
    four, sample = store.load_sample(key), store.load_sample(key, contract=two)
    assert four.camera_indices.tolist() == [0, 1, 2, 6]
    assert sample.camera_indices.tolist() == [0, 1, 2, 3, 5, 6]
    assert sample.image_frames.shape == (6, 4, 3, 72, 128)
    np.testing.assert_array_equal(sample.image_frames[[0, 1, 2, 5]], four.image_frames)
    np.testing.assert_array_equal(sample.image_frames[3], four.image_frames[0])
    assert summarize_stored(store, CLIP)["clip"]["contracts"] == ["alpamayo-r1", "alpamayo-1.5", "alpamayo-2"]


def test_a_clip_of_four_cameras_gives_no_sample_of_six(store):
    with pytest.raises(InputError, match=f"no {REAR_LEFT}, {REAR_RIGHT}; a policy sample of alpamayo-2 needs"):
        store.load_sample(SampleKey(str(store.root), CLIP, 2_000_000), contract=find_contract("alpamayo-2"))
