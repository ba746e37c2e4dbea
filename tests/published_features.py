"""`features.csv` as PhysicalAI-AV publishes it: members that the layout does not write, and features beside its own."""

import json

import pandas as pd

_MORE = [
    ("egomotion.offline", "labels", {"egomotion.offline": "{clip_id}.egomotion.offline.parquet"}),
    ("lidar_top_360fov", "lidar", {"lidar": "{clip_id}.lidar_top_360fov.parquet"}),
    ("camera_intrinsics.offline", "calibration", None),
]


def write_published_features(root):
    """Rewrite the table of a folder: JSON in another order and spacing, numbers as `:04`, more members and rows."""
    path = root / "features.csv"
    table = pd.read_csv(path, dtype=str).set_index("feature")
    for name, directory, members in _MORE:
        suffix = "zip" if members else "parquet"
        chunk_path = f"{directory}/{name}/{name}.chunk_{{chunk_id:04d}}.{suffix}"
        table.loc[name] = [directory, chunk_path, json.dumps(members) if members else None]
    for name in table.index[table["directory"] == "camera"]:
        members = json.loads(table.at[name, "clip_files_in_zip"])
        members = {"blurred_boxes": f"{{clip_id}}.{name}.blurred_boxes.parquet", **dict(reversed(members.items()))}
        table.at[name, "clip_files_in_zip"] = json.dumps(members, separators=(",", ":"))
    table["chunk_path"] = table["chunk_path"].str.replace(":04d", ":04")
    table.iloc[::-1].reset_index().to_csv(path, index=False)
