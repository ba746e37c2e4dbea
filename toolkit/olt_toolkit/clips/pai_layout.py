"""Names of files, members and features in a PhysicalAI-AV tree (docs/formats/physicalai_av.md)."""

import json
from dataclasses import dataclass, field
from pathlib import Path

from olt_toolkit.rigs.rig import CAMERA_INDEX

FEATURE_TABLE = "features.csv"
CLIP_INDEX = "clip_index.parquet"
DEFAULT_SPLITS = "splits/default.parquet"
FEATURE_PRESENCE = "metadata/feature_presence.parquet"
DATA_COLLECTION = "metadata/data_collection.parquet"

VIDEO = "video"
FRAME_TIMESTAMPS = "frame_timestamps"
EGOMOTION = "egomotion"
PIXEL_ORIGIN = "pixel_origin"
ROUTE = "route"
OBSTACLES = "obstacle.offline"
HOLDS = "hold"
ROAD = "road"
CAMERA_INTRINSICS = "camera_intrinsics"
SENSOR_EXTRINSICS = "sensor_extrinsics"
VEHICLE_DIMENSIONS = "vehicle_dimensions"
CALIBRATIONS = (CAMERA_INTRINSICS, SENSOR_EXTRINSICS, VEHICLE_DIMENSIONS)


@dataclass(frozen=True)
class Feature:
    """One kind of data, packed by chunk, below a top folder.

    `members` of zipped features are alias to name of the member; `{clip_id}` stands for the clip. They are empty for
    the others, which are one Parquet table a chunk.
    """

    name: str
    directory: str
    members: dict[str, str] = field(default_factory=dict)

    @property
    def chunk_path(self) -> str:
        """Path of a chunk in the tree; `{chunk_id:04d}` stands for its number."""
        suffix = "zip" if self.members else "parquet"
        return f"{self.directory}/{self.name}/{self.name}.chunk_{{chunk_id:04d}}.{suffix}"

    def chunk_file(self, root: Path, chunk: int) -> Path:
        """File of one chunk."""
        return root / self.chunk_path.format(chunk_id=chunk)

    def member(self, alias: str, clip_id: str) -> str:
        """Name of a clip's member in the chunk's zip."""
        return self.members[alias].format(clip_id=clip_id)


FEATURES: dict[str, Feature] = {
    **{
        camera: Feature(
            camera,
            "camera",
            {VIDEO: f"{{clip_id}}.{camera}.mp4", FRAME_TIMESTAMPS: f"{{clip_id}}.{camera}.timestamps.parquet"},
        )
        for camera in CAMERA_INDEX
    },
    EGOMOTION: Feature(EGOMOTION, "labels", {EGOMOTION: f"{{clip_id}}.{EGOMOTION}.parquet"}),
    **{name: Feature(name, "calibration") for name in CALIBRATIONS},
}

# Beside the public tree, which does not know of them: masks that tell where the pixels of a view come from.
PIXEL_ORIGINS: dict[str, Feature] = {
    camera: Feature(
        f"{camera}.{PIXEL_ORIGIN}",
        PIXEL_ORIGIN,
        {PIXEL_ORIGIN: f"{{clip_id}}.{camera}.{PIXEL_ORIGIN}.parquet"},
    )
    for camera in CAMERA_INDEX
}
# And what a source knows beyond images and motion; boxes in the columns of the public table.
TRUTHS: dict[str, Feature] = {
    name: Feature(name, "labels", {name: f"{{clip_id}}.{name}.parquet"}) for name in (ROUTE, OBSTACLES, HOLDS, ROAD)
}
STORED: dict[str, Feature] = FEATURES | {feature.name: feature for feature in PIXEL_ORIGINS.values()} | TRUTHS
"""Everything that a store holds in chunks, by name."""


def feature_rows() -> list[dict[str, str | None]]:
    """Rows of `features.csv`. An unused `clip_files_in_zip` must be empty: the readers take `{}` for a zip."""
    return [
        {
            "feature": feature.name,
            "directory": feature.directory,
            "chunk_path": feature.chunk_path,
            "clip_files_in_zip": json.dumps(feature.members) if feature.members else None,
        }
        for feature in FEATURES.values()
    ]
