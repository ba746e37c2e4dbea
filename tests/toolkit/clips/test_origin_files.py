import io

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from olt_generator.errors import InputError
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.clips.clip import ViewProvenance
from olt_toolkit.clips.origin_files import decode_origin, encode_origin

SHAPES = st.tuples(st.integers(1, 4), st.integers(1, 9), st.integers(1, 9))
MASKS = SHAPES.flatmap(lambda shape: arrays(np.uint8, shape, elements=st.integers(0, len(PixelOrigin) - 1)))


def times_of(masks):
    return 100_000 * np.arange(len(masks), dtype=np.int64) - 7


@given(MASKS)
def test_masks_come_back_with_their_times_and_shares(masks):
    data = encode_origin(times_of(masks), masks)
    runs = decode_origin(data, "here")
    assert (runs.height, runs.width) == masks.shape[1:]
    np.testing.assert_array_equal(runs.timestamps_us, times_of(masks))
    np.testing.assert_array_equal(runs.masks(np.arange(len(masks))), masks)
    np.testing.assert_array_equal(runs.masks(np.array([len(masks) - 1, 0])), masks[[-1, 0]])
    view = ViewProvenance("warped", "test", "1", None, 0.0, 1.0).with_shares(masks)
    assert {name: getattr(view, name) for name in runs.shares} == runs.shares
    seen = (masks == PixelOrigin.SAME_FRAME) | (masks == PixelOrigin.OTHER_FRAME)
    np.testing.assert_array_equal(runs.seen_frames, seen.any(axis=(1, 2)))
    assert view.unseen_share == pytest.approx((masks == PixelOrigin.UNSEEN).mean())
    assert encode_origin(times_of(masks), masks.copy()) == data


def test_other_readers_find_plain_columns():
    masks = np.array([[[0, 0, 1], [1, 2, 3]]], np.uint8)
    table = pd.read_parquet(io.BytesIO(encode_origin(np.array([5]), masks)))
    assert table["timestamp"].tolist() == [5]
    assert table["origin"][0].tolist() == [0, 1, 2, 3]
    assert table["length"][0].tolist() == [2, 2, 1, 1]


def rewritten(change):
    """A table of two masks of 3 x 2 pixels with one thing changed."""
    masks = np.zeros((2, 2, 3), np.uint8)
    masks[:, 1] = 1
    table = pq.read_table(io.BytesIO(encode_origin(np.array([0, 1]), masks)))
    sink = io.BytesIO()
    pq.write_table(change(table), sink)
    return sink.getvalue()


def with_column(table, name, values, kind):
    return table.set_column(table.schema.get_field_index(name), name, pa.array(values, kind))


BYTES, COUNTS = pa.list_(pa.uint8()), pa.list_(pa.uint32())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table.drop_columns("length"), "column length is missing"),
        (lambda table: with_column(table, "length", [[3, 3], [3, 3]], pa.list_(pa.int64())), "columns are"),
        (lambda table: table.replace_schema_metadata({}), "no width and height"),
        (lambda table: table.replace_schema_metadata({"width": "3", "height": "-2"}), "no width and height"),
        (lambda table: table.replace_schema_metadata({"width": "4", "height": "2"}), "not those of masks of 4 x 2"),
        (lambda table: with_column(table, "length", [[3, 3], [3, 2]], COUNTS), "not those of masks of 3 x 2"),
        (lambda table: with_column(table, "length", [[3, 3], [6]], COUNTS), "not those of masks"),
        (lambda table: with_column(table, "length", [[3, 3], None], COUNTS), "not those of masks"),
        (lambda table: with_column(table, "origin", [[0, 1], [0, 4]], BYTES), "not those of masks"),
        (lambda table: with_column(table, "origin", [[0, 1], [0, None]], BYTES), "not those of masks"),
    ],
)
def test_what_contradicts_itself_is_refused(change, message):
    with pytest.raises(InputError, match=f"^here: {message}|^here.*{message}"):
        decode_origin(rewritten(change), "here")


def test_what_is_no_table_is_refused():
    with pytest.raises(InputError, match="here"):
        decode_origin(b"text", "here")
