"""Leaks as they are found: all are counted and the first of each rule kept, and all are written where a file is given.

So a table in which millions of scenes leak takes no more memory than one in which none does.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import polars as pl

from olt_datasets.tables.leak_report import ClipPlace, Leak
from olt_datasets.tables.near_duplicate_match import Match
from olt_generator.files import write_whole

TOLD = 1000
"""Leaks of each rule that a report tells one by one."""
PLACE = ("clip_id", "scene_id", "split", "store")
_OTHER = tuple(f"{name}_other" for name in PLACE)
SCHEMA = pl.Schema(
    dict.fromkeys(("rule", *PLACE, *_OTHER, "kind", "kind_other", "source"), pl.String)
    | dict.fromkeys(("from_us", "to_us", "pairs"), pl.Int64)
    | {"score": pl.Float64, "lag_s": pl.Float64, "mirrored": pl.Boolean}
)
"""Columns of a table of leaks: docs/concepts.md, Leaks."""
_ORDER = ("rule", "scene_id", "clip_id", "scene_id_other", "clip_id_other", "store", "kind", "split", "split_other")

Write = Callable[[pl.DataFrame], None]


class LeakListing:
    """Counts the leaks that are added, and keeps the first of each rule by scene and clip.

    Args:
        split: the split of the mixture, for words.
        write: is given all that is added, with the columns of `SCHEMA`.
    """

    def __init__(self, split: str, write: Write | None = None) -> None:
        self._split, self._write = split, write
        self._first = SCHEMA.to_frame()
        self.counts: Counter[str] = Counter()

    def add(self, parts: Iterable[pl.DataFrame], rule: pl.Expr | str) -> None:
        """Add leaks by a rule, or by one that each row tells; columns of `SCHEMA` that they lack are null."""
        for part in parts:
            missing = {name: pl.lit(None, dtype) for name, dtype in SCHEMA.items() if name not in part.columns}
            rows = part.with_columns(**missing).with_columns(rule=pl.lit(rule) if isinstance(rule, str) else rule)
            rows = rows.select(pl.col(name).cast(dtype) for name, dtype in SCHEMA.items())
            rows = rows.with_columns(pl.col("pairs").fill_null(1))
            self.counts.update(dict(rows.group_by("rule").len().rows()))
            if self._write is not None:
                self._write(rows)
            self._first = pl.concat([self._first, rows]).sort(_ORDER).group_by("rule", maintain_order=True).head(TOLD)

    def leaks(self) -> tuple[Leak, ...]:
        """The first of each rule, in the order in which rules were added."""
        rules = list(self.counts)
        told = sorted(self._first.iter_rows(named=True), key=lambda row: rules.index(row["rule"]))
        return tuple(
            Leak(row["rule"], row["scene_id"], *self._describe(row), row["pairs"], _match(row)) for row in told
        )

    def _describe(self, row: dict[str, Any]) -> tuple[str, tuple[ClipPlace, ...]]:
        """What was found, in words, and its clips."""
        place, kind, other_kind = ClipPlace(*(row[name] for name in PLACE)), row["kind"], row["kind_other"]
        if row["rule"] == "split":
            words = f"clip {place.clip_id} is of split {place.split or 'none'}, the mixture of split {self._split}"
            return words, (place,)
        if row["rule"] == "held out":
            return f"clip {place.clip_id} shows a held-out scene", (place,)
        if row["rule"] == "external":
            return f"source {row['source']} is external: it is never trained on", (place,)
        other = ClipPlace(*(row[name] for name in _OTHER))
        if row["rule"] == "near-duplicate":
            return f"{place} looks like {other}: {_match(row)}", (place, other)
        return (
            f"its {kind} clips in split {place.split} and its {other_kind} clips in {other.split} both show "
            f"moments from {row['from_us'] / 1e6:.6g} to {row['to_us'] / 1e6:.6g} s"
        ), (place, other)


def _match(row: dict[str, Any]) -> Match | None:
    return None if row["score"] is None else Match(row["score"], row["lag_s"], row["mirrored"])


@contextmanager
def write_leaks(path: Path | None) -> Iterator[Write | None]:
    """A function that writes leaks to a Parquet file, which appears whole; None without a path."""
    if path is None:
        yield None
        return
    import pyarrow.parquet as pq

    columns = SCHEMA.to_frame().to_arrow(compat_level=pl.CompatLevel.oldest()).schema
    with write_whole(path) as temporary, pq.ParquetWriter(temporary, columns, compression="zstd") as writer:
        yield lambda rows: writer.write_table(rows.to_arrow(compat_level=pl.CompatLevel.oldest()))
