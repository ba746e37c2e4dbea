"""Hashes of what was recorded."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_datasets.sources.content import hash_content, read_content
from olt_generator.errors import InputError

PARTS = st.lists(st.binary(max_size=4), max_size=4)


@given(first=PARTS, second=PARTS)
def test_only_equal_parts_have_equal_hashes(first, second):
    assert (hash_content(*first) == hash_content(*second)) == (first == second)


def test_arrays_are_told_by_type_and_shape_and_not_by_the_order_of_their_bytes():
    times = np.arange(6)
    assert hash_content(times) == hash_content(times.astype(">i8")) == hash_content(np.repeat(times, 2)[::2])
    others = [times.astype(np.int32), times.reshape(2, 3), times.astype(float), times[::-1]]
    assert len({hash_content(each) for each in (times, *others)}) == 5


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    (tmp_path / "gone.png").symlink_to(tmp_path / "nowhere.png")
    with pytest.raises(InputError, match=r"gone\.png: cannot be read"):
        read_content(tmp_path / "gone.png")
