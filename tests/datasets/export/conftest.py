"""Small clip stores to export, and readers by the rules of the public ones."""

import io
import json
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, REAR_LEFT, REAR_RIGHT
from olt_toolkit.rigs.rig_files import pav_rig

from ...straight_clips import HEIGHT, WIDTH, straight_clip, write_clips

REVISION = "0" * 40


@pytest.fixture(scope="session")
def stores(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two stores: `real` with a chunk of two GT clips and a mixed one (one GT, one held out, one too short), and
    `made` with two Syn clips. Every clip that gives samples does so at 1.7 to 2.1 s."""
    folder = tmp_path_factory.mktemp("stores")
    real = write_clips(
        folder / "real",
        [straight_clip("a", grey=20), straight_clip("b", grey=40)],
        [straight_clip("c", grey=60), straight_clip("held out", split="val"), straight_clip("short", rows=50)],
    )
    made = write_clips(
        folder / "made", [straight_clip("d", kind="Syn", grey=80), straight_clip("e", kind="Syn", grey=100)]
    )
    return real, made


@pytest.fixture(scope="session")
def masked_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of two Syn clips in one chunk: `four` of four cameras, and `six` with the rear ones of Alpamayo 2 too.

    The left cross view of both is invented but for as many columns as the number of the frame, from 0 to 7.
    """
    clips = []
    for name in ("four", "six"):
        clip = straight_clip(name, kind="Syn")
        left = clip.streams[CROSS_LEFT]
        columns = np.arange(WIDTH) < np.arange(len(left.frames))[:, None]
        origin = np.repeat(np.where(columns, 1, 0).astype(np.uint8)[:, None], HEIGHT, axis=1)
        streams = clip.streams | {CROSS_LEFT: replace(left, origin=origin)}
        provenance = clip.provenance | {CROSS_LEFT: clip.provenance[CROSS_LEFT].with_shares(origin)}
        if name == "six":
            rig = pav_rig().fitted(WIDTH, HEIGHT)
            for rear, cross in ((REAR_LEFT, CROSS_LEFT), (REAR_RIGHT, CROSS_RIGHT)):
                mounted = rig[rear]
                streams[rear] = replace(streams[cross], camera=mounted.camera, T_rig_camera=mounted.T_rig_camera)
            provenance |= {REAR_LEFT: provenance[CROSS_LEFT], REAR_RIGHT: provenance[CROSS_RIGHT]}
        clips.append(replace(clip, streams=streams, provenance=provenance))
    return write_clips(tmp_path_factory.mktemp("masked") / "masked", clips)


class RecipeReader:
    """The clips of a folder by the rules of the Alpamayo recipes' local reader: plain files, no filter by split."""

    def __init__(self, root: Path, chunk_ids: str | None = None) -> None:
        self.root = root
        self.features = pd.read_csv(root / "features.csv", index_col="feature")
        self.index = pd.read_parquet(root / "clip_index.parquet")
        presence = pd.read_parquet(root / "metadata" / "feature_presence.parquet")
        assert self.index.index.is_unique and self.index["chunk"].dtype == np.int64
        assert presence.index.tolist() == self.index.index.tolist()
        assert all(dtype == np.bool_ for dtype in presence.dtypes)
        first, last = (0, 10_000) if chunk_ids is None else map(int, chunk_ids.split("-"))
        self.clip_ids = [clip_id for clip_id, chunk in self.index["chunk"].items() if first <= chunk < last]

    def keyframe(self, clip_id: str) -> int:
        return int(self.index.at[clip_id, "event_t0s"][0])

    def table(self, clip_id: str, feature: str) -> pd.DataFrame | pd.Series:
        return pd.read_parquet(self._chunk_file(clip_id, feature)).loc[clip_id]

    def members(self, clip_id: str, feature: str) -> dict[str, bytes]:
        names = json.loads(self.features.at[feature, "clip_files_in_zip"])
        with zipfile.ZipFile(self._chunk_file(clip_id, feature)) as archive:
            return {alias: archive.read(name.format(clip_id=clip_id)) for alias, name in names.items()}

    def _chunk_file(self, clip_id: str, feature: str) -> Path:
        return self.root / self.features.at[feature, "chunk_path"].format(chunk_id=self.index.at[clip_id, "chunk"])


@pytest.fixture(scope="session")
def recipe_reader() -> type[RecipeReader]:
    return RecipeReader


@pytest.fixture
def open_devkit(tmp_path: Path) -> Iterator[Callable[[Path], object]]:
    """Opens a folder with the public devkit, offline: it reads a hub cache only, so the cache points to the folder."""
    pytest.importorskip("physical_ai_av", reason="physical-ai-av (extra `interop`) is not installed")
    import huggingface_hub.constants
    from physical_ai_av import PhysicalAIAVDatasetInterface

    def open_folder(root: Path) -> PhysicalAIAVDatasetInterface:
        cache = tmp_path / "cache"
        snapshots = cache / "datasets--nvidia--PhysicalAI-Autonomous-Vehicles" / "snapshots"
        snapshots.mkdir(parents=True)
        (snapshots / REVISION).symlink_to(root, target_is_directory=True)
        return PhysicalAIAVDatasetInterface(REVISION, cache_dir=cache, token=False)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
        yield open_folder


def _public_sample(motion: object, cameras: dict[str, object], t0_us: int) -> dict[str, np.ndarray]:
    """What the public loader makes of the devkit's objects (docs/formats/physicalai_av.md), in numpy."""
    assert t0_us > 1_600_000
    past, future = t0_us + 100_000 * np.arange(-15, 1), t0_us + 100_000 * np.arange(1, 65)
    position = {name: motion(times).pose.translation for name, times in {"history": past, "future": future}.items()}
    rotation = {name: motion(times).pose.rotation for name, times in {"history": past, "future": future}.items()}
    origin, turn = position["history"][-1], Rotation.from_matrix(rotation["history"].as_matrix()[-1]).inv()
    images, times_us = zip(
        *(reader.decode_images_from_timestamps(past[-4:].astype(np.int64)) for reader in cameras.values()), strict=True
    )
    sample = {"image_frames": np.stack(images).transpose(0, 1, 4, 2, 3), "absolute_timestamps": np.stack(times_us)}
    for name in position:
        sample[f"ego_{name}_xyz"] = turn.apply(position[name] - origin)[None]
        sample[f"ego_{name}_rot"] = (turn * Rotation.from_matrix(rotation[name].as_matrix())).as_matrix()[None]
    return sample


@pytest.fixture(scope="session")
def public_sample() -> Callable[..., dict[str, np.ndarray]]:
    return _public_sample


@pytest.fixture(scope="session")
def read_parquet_bytes() -> Callable[[bytes], pd.DataFrame]:
    return lambda data: pd.read_parquet(io.BytesIO(data))
