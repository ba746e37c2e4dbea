"""Small clip tables, in memory and as stores on disk."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import olt_toolkit.recordings.drives
from olt_datasets.tables.clip_frame import SCHEMA, SHARES
from olt_toolkit.clips.clip import (
    ClipInfo,
    ClipKind,
    ClipOrigin,
    Split,
)
from olt_toolkit.clips.table import CLIP_TABLE, write_clip_table
from olt_toolkit.recordings.drives import DatasetPlace

from ..straight_clips import straight_clip, write_clips
from .toy_drives import ToyDataset, ToyReader

MakeClip = Callable[..., ClipInfo]
MakeTable = Callable[..., pl.DataFrame]
WriteStore = Callable[..., Path]
OpenToy = Callable[[ToyDataset], tuple[DatasetPlace, ToyDataset]]


def _make_clip(
    number: int,
    kind: ClipKind = "GT",
    category: str = "nominal",
    source: str = "world",
    factors: tuple[str, ...] = (),
    split: Split | None = "train",
    scene_id: str | None = None,
    samples: int = 1,
    origin: ClipOrigin | None = None,
    fingerprint: bytes | None = None,
    doubts: tuple[str, ...] | None = None,
) -> ClipInfo:
    return ClipInfo(
        clip_id=f"00000000-0000-5000-8000-{number:012d}",
        name=f"drive {number}",
        scene_id=scene_id or f"scene_{number}",
        source=source,
        origin=origin or ClipOrigin(f"drive {number}", 0, 20_000_000),
        kind=kind,
        category=category,
        factors=factors,
        split=split,
        doubts=doubts,
        duration_us=20_000_000,
        sample_t0_us=tuple(5_000_000 + 100_000 * index for index in range(samples)),
        no_sample_reason=None if samples else "too short",
        created_with="0.1.0",
        checksum=f"{number:032x}",
        fingerprint=fingerprint,
        views={},
    )


def _mean_shares(clip: ClipInfo) -> dict[str, float | None]:
    return {
        name: np.mean([getattr(view, name) for view in clip.views.values()]) if clip.views else None for name in SHARES
    }


def _make_table(*clips: ClipInfo, store: str = "/store") -> pl.DataFrame:
    rows = [{**vars(clip), **vars(clip.origin), **_mean_shares(clip), "store": store} for clip in clips]
    rows = [{name: row[name] for name in (*SCHEMA, "store")} for row in rows]
    return pl.DataFrame(rows, schema={**SCHEMA, "store": pl.String})


@pytest.fixture(scope="session")
def make_clip() -> MakeClip:
    return _make_clip


@pytest.fixture(scope="session")
def make_table() -> MakeTable:
    return _make_table


@pytest.fixture
def write_store(tmp_path: Path) -> WriteStore:
    """Write a store that is nothing but its clip table."""

    def write(*clips: ClipInfo, name: str = "store") -> Path:
        folder = tmp_path / name
        folder.mkdir(exist_ok=True)
        write_clip_table(folder / CLIP_TABLE, clips)
        return folder

    return write


@pytest.fixture
def open_toy(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> OpenToy:
    """Makes a data set in memory the only one that is installed."""

    def open_one(dataset: ToyDataset) -> tuple[DatasetPlace, ToyDataset]:
        reader, root = ToyReader(dataset), tmp_path_factory.mktemp("toy")
        monkeypatch.setattr(olt_toolkit.recordings.drives, "readers", lambda: {reader.name: reader})
        return DatasetPlace(root, root / "cache"), dataset

    return open_one


@pytest.fixture(scope="session")
def toy_table(make_clip: MakeClip, make_table: MakeTable) -> pl.DataFrame:
    """20 nominal GT clips with 3 samples each and 8 Syn work zones with 2, in different scenes."""
    nominal = [make_clip(number, samples=3) for number in range(20)]
    work_zones = [make_clip(100 + number, kind="Syn", category="work_zone", samples=2) for number in range(8)]
    return make_table(*nominal, *work_zones)


@pytest.fixture(scope="session")
def real_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip store with one straight clip of 9 s, filmed throughout."""
    return write_clips(tmp_path_factory.mktemp("clips"), [straight_clip("straight", images=slice(0, 90))])
