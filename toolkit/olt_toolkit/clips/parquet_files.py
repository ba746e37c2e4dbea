"""Parquet files from outside: opened by one function, which bounds what reading them can cost."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from olt_generator.errors import InputError

# Bytes of one column of a row group once unpacked, and values of one: lists have many to a row.
_LARGEST_CHUNK = 1 << 30
_MOST_VALUES = 1 << 28
_ROWS_AT_ONCE, _FEWEST_AT_ONCE = 65_536, 64
_BYTES_AT_ONCE = 1 << 29


@contextmanager
def open_parquet(source: Path | bytes, where: str) -> Iterator[pq.ParquetFile]:
    """Open a Parquet file, which errors call `where`; Arrow's errors inside become `InputError`.

    Raises:
        InputError: the file is missing, is no readable Parquet file, or claims sizes that no file here has.
    """
    try:
        if isinstance(source, Path) and source.exists() and not source.is_file():
            raise InputError(f"{where}: not a regular file; give a Parquet file")
        # Reading ahead is for far storage: of these small files it takes more than half of the time.
        with pq.ParquetFile(io.BytesIO(source) if isinstance(source, bytes) else source, pre_buffer=False) as file:
            _check_sizes(file.metadata, where)
            names = file.schema_arrow.names
            if len(set(names)) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise InputError(f"{where}: column {twice} is there twice; write the table again")
            yield file
    except FileNotFoundError as error:
        raise InputError(f"{where}: no such file; the clip store is incomplete") from error
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{where}: not a readable Parquet file ({reason:.200}); write it again") from error


def _check_sizes(metadata: pq.FileMetaData, where: str) -> None:
    for chunk in _chunks(metadata):
        if not 0 <= chunk.total_uncompressed_size <= _LARGEST_CHUNK or not 0 <= chunk.num_values <= _MOST_VALUES:
            raise InputError(
                f"{where}: column {chunk.path_in_schema} claims {chunk.num_values} values of "
                f"{chunk.total_uncompressed_size} bytes in one row group; write smaller ones"
            )


def _chunks(metadata: pq.FileMetaData) -> Iterator[pq.ColumnChunkMetaData]:
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        for column in range(group.num_columns):
            yield group.column(column)


def read_rows(file: pq.ParquetFile, where: str) -> pa.Table:
    """All rows of a file that `open_parquet` opened, inside its context; texts are UTF-8.

    Raises:
        InputError: they unpack to more than memory should hold; told before they do.
    """
    table = _unpack(file, where)
    table.validate(full=True)
    return table


def _unpack(file: pq.ParquetFile, where: str) -> pa.Table:
    largest = max((chunk.total_uncompressed_size for chunk in _chunks(file.metadata)), default=0)
    if largest * max(1, file.metadata.num_rows) <= _BYTES_AT_ONCE:
        return file.read()
    batches, size = [], 0
    for batch in file.iter_batches(_FEWEST_AT_ONCE * 16):
        batches.append(batch)
        size += batch.nbytes
        if size > _BYTES_AT_ONCE:
            raise InputError(f"{where}: unpacks to more than {_BYTES_AT_ONCE} bytes; no table here is as large")
    return pa.Table.from_batches(batches, file.schema_arrow)
