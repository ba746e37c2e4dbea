"""Small invented recordings in the formats of the public data sets."""

import gzip
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import feather, parquet

from olt_closed_loop.scenes.sources.argoverse2 import AXLE_HEIGHT

STEPS = 60
SPEED = 8.0
CITY = np.array([5000.0, 2000.0, 70.0])


def points(rows):
    return [{"x": float(x), "y": float(y), "z": float(z)} for x, y, z in rows]


def city_map():
    """Two lanes in a row along x from 20 m behind the start, on a road 12 m wide."""

    def segment(name, start, end, successors, kind="VEHICLE"):
        left, right = ([np.add(CITY, (x, y, 0.0)) for x in (start, end)] for y in (1.8, -1.8))
        lines = {"left_lane_boundary": points(left), "right_lane_boundary": points(right)}
        return {"id": name, "lane_type": kind, "successors": successors, **lines}

    corners = [np.add(CITY, (x, y, 0.0)) for x, y in ((-20, -6), (-20, 6), (300, 6), (300, -6))]  # clockwise
    return {
        "lane_segments": {
            "1": segment(1, -20.0, 40.0, [2]),
            "2": segment(2, 40.0, 300.0, []),
            "3": segment(3, -20.0, 40.0, [], "BIKE"),
        },
        "drivable_areas": {"7": {"id": 7, "area_boundary": points(corners)}},
    }


def write_sensor_log(folder):
    """An ego that drives along x; a parked car 20 m ahead and 3.5 m to the left, annotated in the ego's frame."""
    (folder / "map").mkdir(parents=True)
    (folder / "map" / "log_map_archive_x.json").write_text(json.dumps(city_map()))
    fine = 10**18 + 50_000_000 * np.arange(2 * STEPS, dtype=np.int64)
    x = CITY[0] + SPEED * 0.05 * np.arange(2 * STEPS)
    still = {"qw": np.ones_like(x), "qx": 0 * x, "qy": 0 * x, "qz": 0 * x}
    poses = {"timestamp_ns": fine, **still, "tx_m": x, "ty_m": 0 * x + CITY[1], "tz_m": 0 * x + CITY[2]}
    feather.write_feather(pa.table(poses), folder / "city_SE3_egovehicle.feather")
    seen = slice(4, 100, 2)
    count = len(fine[seen])
    turn = np.full(count, 0.3)
    boxes = {
        "timestamp_ns": fine[seen],
        "track_uuid": ["parked"] * count,
        "category": ["REGULAR_VEHICLE"] * count,
        "length_m": np.full(count, 4.5),
        "width_m": np.full(count, 1.8),
        "height_m": np.full(count, 1.5),
        "qw": np.cos(turn / 2),
        "qx": 0 * turn,
        "qy": 0 * turn,
        "qz": np.sin(turn / 2),
        "tx_m": CITY[0] + 20.0 - x[seen],
        "ty_m": np.full(count, 3.5),
        "tz_m": np.full(count, 0.75 - AXLE_HEIGHT),
    }
    feather.write_feather(pa.table(boxes), folder / "annotations.feather")
    return folder


def write_motion_scenario(folder):
    """An ego and a cyclist that drive along x, and something without a size."""
    folder.mkdir()
    (folder / "log_map_archive_x.json").write_text(json.dumps(city_map()))
    tracks = {"AV": ("vehicle", 0.0, 0.0), "9": ("cyclist", 12.0, 4.0), "8": ("background", 3.0, 9.0)}
    rows = [
        {
            "track_id": name,
            "object_type": kind,
            "timestep": step,
            "position_x": CITY[0] + ahead + SPEED * 0.1 * step,
            "position_y": CITY[1] + left,
            "heading": 0.0,
            "scenario_id": "abc",
        }
        for step in reversed(range(STEPS))
        for name, (kind, ahead, left) in tracks.items()
    ]
    parquet.write_table(pa.Table.from_pylist(rows), folder / "scenario_abc.parquet")
    return folder


def scenario(turned=False):
    times = 0.1 * np.arange(STEPS)

    def state(x, y, size, valid, heading=0.0):
        return {
            "position": np.column_stack([1000.0 + x, 500.0 + y + 0 * x, 3.0 + 0 * x]).tolist(),
            "heading": (heading + 0 * x).tolist(),
            "valid": valid,
            **{name: [[value]] * STEPS for name, value in zip(("length", "width", "height"), size, strict=True)},
        }

    along = np.linspace(-20.0, 300.0, 40)
    lane = {"type": "LANE_SURFACE_STREET", "polyline": np.column_stack([1000 + along, 500 + 0 * along, along]).tolist()}
    wide = [[980.0, 497.0], [1300.0, 497.0], [1300.0, 503.0], [980.0, 503.0]]
    seen = [0] * 10 + [1] * (STEPS - 10)
    tracks = {
        "ego": {"metadata": {"type": "vehicle.car"}, "state": state(SPEED * times, 0.0, (1.7, 4.1, 1.6), [1] * STEPS)},
        "bus": {
            "metadata": {"type": "vehicle.bus.rigid"},
            "state": state(60.0 + 0 * times, 8.0, (11, 2.9, 3.4), seen, 3.0),
        },
    }
    features = {"with area": {**lane, "polygon": wide}, "line": {"type": "ROAD_LINE", "polyline": [[0, 0], [1, 1]]}}
    if turned:  # only a centre line 1.5 m beside the drive, whose usual width does not hold the ego
        beside = np.column_stack([1000 + along, 501.5 + 0 * along]).tolist()
        features = {"without area": {"type": "LANE_SURFACE_STREET", "polyline": beside}}
    metadata = {"ts": (12.5 + times).tolist(), "sdc_id": "ego"}
    return {"id": "scene-1", "metadata": metadata, "tracks": tracks, "map_features": features}


def write_scenario(path: Path, content) -> Path:
    path.write_bytes(gzip.compress(json.dumps(content).encode()))
    return path
