"""Fake fingerprints are as alike as roads are, none is found to be a copy, and a copy is."""

import numpy as np
import polars as pl

from olt_datasets.benchmarks.fake_fingerprints import draw_fingerprints
from olt_datasets.tables.fingerprints import find_near_duplicates
from olt_toolkit.clips.fingerprint import unpack_signs


def test_none_is_a_copy_of_another_and_a_later_part_of_one_is_found():
    records = draw_fingerprints(60, seed=1)
    assert np.array_equal(records, draw_fingerprints(60, seed=1))
    looks = pl.Series([images.tobytes() for images in records], dtype=pl.Binary)
    names = pl.Series([f"scene {number}" for number in range(len(looks))])
    assert find_near_duplicates(looks, looks, names, names).tolist() == []
    parts = pl.Series([images[4:].tobytes() for images in records], dtype=pl.Binary)
    assert find_near_duplicates(parts, looks).tolist() == [[place, place] for place in range(len(looks))]


def test_images_of_other_clips_are_somewhat_alike():
    signs = unpack_signs(draw_fingerprints(40, seed=2)["signs"][:, 0])
    likeness = (signs @ signs.T / signs.shape[1])[np.triu_indices(40, 1)]
    assert 0.2 < likeness.mean() < 0.5
