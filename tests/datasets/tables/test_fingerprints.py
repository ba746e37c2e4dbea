"""A changed copy of a drive is found, another drive is not, and what could not be compared is told."""

import cv2
import numpy as np
import polars as pl
import pytest

from olt_datasets.benchmarks.copies import KINDS, Drive, copy_window
from olt_datasets.benchmarks.fake_fingerprints import draw_fingerprints
from olt_datasets.benchmarks.near_duplicates import fingerprint
from olt_datasets.tables import fingerprints as module
from olt_datasets.tables import thumbnail_index
from olt_datasets.tables.fingerprints import find_near_duplicates, is_telling, search_near_duplicates
from olt_datasets.tables.near_duplicate_match import Match
from olt_generator.errors import InputError
from olt_generator.seeds import make_generator


def make_drive(name):
    """A flight into layers of smooth structure: what is ahead grows, and the bonnet stays."""
    random = make_generator("drive", name)
    octaves = [random.integers(0, 256, (5, 2 * n, 3 * n, 3)).astype(np.uint8) for n in (2, 4, 8, 16)]
    enlarged = [[cv2.resize(image, (640, 360), interpolation=cv2.INTER_CUBIC) for image in each] for each in octaves]
    layers = np.average(enlarged, axis=0, weights=(8, 4, 2, 1)).astype(np.uint8)
    frames = []
    for number in range(60):
        depth = number / 15.0
        scale, layer = 1.0 + depth % 1.0, int(depth)
        matrix = cv2.getRotationMatrix2D((320, 180), 0.0, scale)
        image = cv2.addWeighted(
            cv2.warpAffine(layers[layer], matrix, (640, 360)), 1.0 - depth % 1.0, layers[layer + 1], depth % 1.0, 0.0
        )
        image[320:] = (60, 60, 70)
        frames.append(cv2.resize(image, (240, 135), interpolation=cv2.INTER_AREA))
    return Drive(name, np.stack(frames), 200_000 * np.arange(60))


@pytest.fixture(scope="module")
def drives():
    return [make_drive(name) for name in "abcdef"]


def series(drives):
    return pl.Series([fingerprint(drive) for drive in drives], dtype=pl.Binary)


def search(first, second):
    return search_near_duplicates(
        *(
            pl.LazyFrame({"fingerprint": series(each)}).with_columns(scene_id=pl.lit(None, pl.String))
            for each in (first, second)
        )
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_changed_copy_is_found_among_other_drives(drives, kind):
    pairs = [copy_window(drive, kind, make_generator(kind, drive.name)) for drive in drives]
    windows, copies = zip(*pairs, strict=True)
    found = find_near_duplicates(series(copies), series(windows)).tolist()
    assert [pair for pair in found if pair[0] != pair[1]] == []
    # These move smooth structure by most; one in six may be missed.
    assert len(found) >= len(drives) - (kind in ("crop", "turn", "two at once"))


def test_other_drives_are_not_alike(drives):
    names = pl.Series([drive.name for drive in drives])
    assert find_near_duplicates(series(drives), series(drives), names, names).tolist() == []


def test_how_alike_two_clips_are_is_told(drives):
    """The copy starts 1.18 s later, so that what it shows comes so much later in the other."""
    window, late = drives[0].window(0.0, 0.6), drives[0].window(0.1, 0.6)
    mirrored = Drive("mirrored", late.frames[:, :, ::-1], late.times_us)
    score, lag_s, turned = search([window], [window]).matches.row(0)
    assert score == pytest.approx(1.25, abs=0.15) and (lag_s, turned) == (0.0, False)
    less, late_s, turned = search([mirrored], [window]).matches.row(0)
    assert late_s == pytest.approx(1.18, abs=0.4) and turned and less < score
    _, early_s, turned = search([window], [mirrored]).matches.row(0)
    assert early_s == pytest.approx(-1.18, abs=0.4)
    assert str(Match(0.9, -1.2, mirrored=True)) == "score 0.90 of 1.25, 1.2 s earlier, mirrored"


def test_a_fingerprint_of_another_form_is_refused(drives):
    looks = pl.Series([fingerprint(drives[0]), b"1234567"], dtype=pl.Binary)
    with pytest.raises(InputError, match="row 1: its fingerprint has 7 bytes"):
        find_near_duplicates(looks, looks)


def test_clips_of_one_scene_are_no_pair_and_those_of_unknown_scenes_are(drives):
    looks, scene = series(drives[:1]), pl.Series(["street"])
    assert find_near_duplicates(looks, looks, scene, scene).tolist() == []
    assert find_near_duplicates(looks, looks, scene, pl.Series(["field"])).tolist() == [[0, 0]]
    assert find_near_duplicates(looks, looks).tolist() == [[0, 0]]


def test_clips_that_show_nothing_are_not_compared(drives):
    looks = pl.Series([None, b"", fingerprint(drives[0])], dtype=pl.Binary)
    assert is_telling(looks).to_list() == [False, False, True]
    assert find_near_duplicates(looks, looks).tolist() == [[2, 2]]
    assert find_near_duplicates(looks[:2], looks[:2]).shape == (0, 2)
    assert find_near_duplicates(looks[:0], looks[:0]).shape == (0, 2)


def test_a_standing_clip_is_found(drives):
    standing = Drive("standing", np.repeat(drives[0].frames[:1], 30, axis=0), 200_000 * np.arange(30))
    assert find_near_duplicates(series([standing]), series([standing.window(0.2, 0.5)])).tolist() == [[0, 0]]
    assert find_near_duplicates(series([standing]), series([drives[1]])).tolist() == []


def test_each_of_many_alike_clips_has_one_like_clip(drives):
    looks = pl.Series([fingerprint(drives[0])] * 60, dtype=pl.Binary)
    pairs = find_near_duplicates(looks, looks)
    assert pairs[:, 0].tolist() == list(range(60))


def test_clips_with_more_candidates_than_are_compared_are_told(drives):
    """Of the 30 clips that share all keys with one, 29 are of its own scene, and take the place of the last."""
    looks, scenes = [fingerprint(drives[0])], ["crowd"]
    lone = pl.LazyFrame({"fingerprint": looks, "scene_id": scenes})
    crowd = pl.LazyFrame({"fingerprint": looks * 30, "scene_id": scenes * 29 + ["other"]})
    search = search_near_duplicates(lone, crowd)
    assert search.pairs.tolist() == [[0, 29]] or search.crowded.tolist() == [0]
    few = search_near_duplicates(lone, crowd.tail(2))
    assert (few.pairs.tolist(), few.crowded.tolist()) == ([[0, 1]], [])


def test_the_search_in_parts_finds_what_it_finds_at_once(drives, monkeypatch):
    looks = series(drives)
    found = find_near_duplicates(looks, looks).tolist()
    monkeypatch.setattr(thumbnail_index, "_KEYS_AT_ONCE", 16 * 8 * 2)
    monkeypatch.setattr(module, "_PROBES_AT_ONCE", 16 * 8 * 6)
    monkeypatch.setattr(thumbnail_index, "_ROWS_AT_ONCE", 3)
    assert find_near_duplicates(looks, looks).tolist() == found == [[place, place] for place in range(len(drives))]


def test_what_is_found_of_a_clip_does_not_depend_on_the_clips_beside_it():
    """A mixture is held against less than a whole table is, and must not leak where the table does not."""
    first, second = (
        pl.Series([each.tobytes() for each in draw_fingerprints(count, count)], dtype=pl.Binary) for count in (900, 60)
    )
    of_all = find_near_duplicates(first, second)
    starts = range(0, len(first), 50)
    parts = [find_near_duplicates(first[start : start + 50], second) + np.array([start, 0]) for start in starts]
    assert np.concatenate(parts).tolist() == of_all.tolist()
