"""Files of rollouts: Parquet, one row a rollout.

| column | what |
| --- | --- |
| scene, category, policy, traffic, failure, failure_kind | text, the last two absent where the rollout is valid |
| seed, handover_us | int64 |
| plan_deviation_max, plan_deviation_rms | float64, metres, absent where not measured |
| timestamps_us, plan_times_us | lists of int64 |
| states, heights, controls, plans | lists of float64, the last index of the arrays in `Rollout` running first |
| one column for each count of `Incidents` | int64 |
| rendered_images, left_out, vehicle_steps, reacted | JSON text |
| timings | JSON text, or absent: equal runs give equal files without |

The metadata of the file holds its version under `olt_rollouts`.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from olt_closed_loop.rollouts.rollout import INCIDENTS, Rollout
from olt_closed_loop.vehicle.state import STATE_SIZE
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_toolkit.clips.parquet_files import open_parquet, read_rows

FILE_VERSION = 3
"""Of files of rollouts; those of other versions are refused. Up to 2 they were JSON."""

_TEXTS = ("scene", "category", "policy", "traffic", "failure", "failure_kind")
_NUMBERS = ("seed", "handover_us")
_MEASURES = ("plan_deviation_max", "plan_deviation_rms")
_TIMES = ("timestamps_us", "plan_times_us")
_ARRAYS = ("states", "heights", "controls", "plans")
_RECORDS = ("rendered_images", "left_out", "vehicle_steps", "reacted", "timings")
_VERSION_KEY = b"olt_rollouts"
_SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in _TEXTS),
        *((name, pa.int64()) for name in _NUMBERS),
        *((name, pa.float64()) for name in _MEASURES),
        *((name, pa.list_(pa.int64())) for name in _TIMES),
        *((name, pa.list_(pa.float64())) for name in _ARRAYS),
        *((name, pa.int64()) for name in INCIDENTS),
        *((name, pa.string()) for name in _RECORDS),
    ],
    metadata={_VERSION_KEY: str(FILE_VERSION).encode()},
)


def save_rollouts(path: Path, rollouts: Sequence[Rollout], timings: bool = True) -> None:
    """Write rollouts as one Parquet file, whole or not at all; without timings, equal rollouts give equal bytes."""
    table = pa.Table.from_pylist([_row(rollout, timings) for rollout in rollouts], schema=_SCHEMA)
    with write_whole(path) as temporary:
        pq.write_table(table, temporary, compression="zstd")


def load_rollouts(path: Path) -> list[Rollout]:
    """Read what `save_rollouts` wrote; timings that were left out are empty.

    Raises:
        InputError: the file is missing, damaged, holds something else, or was written by another version.
    """
    if path.suffix == ".json":
        raise InputError(f"{path}: rollouts of version 2 or earlier, not {FILE_VERSION}; simulate them again")
    with open_parquet(path, str(path)) as file:
        version = (file.schema_arrow.metadata or {}).get(_VERSION_KEY)
        if version is None:
            raise InputError(f"{path}: not a file of rollouts; give one that `olt closed-loop run` wrote")
        if version != str(FILE_VERSION).encode():
            raise InputError(f"{path}: rollouts of version {version.decode()}, not {FILE_VERSION}; simulate them again")
        if not file.schema_arrow.equals(_SCHEMA):
            raise InputError(f"{path}: columns are not those of rollouts; simulate them again")
        rows = read_rows(file, str(path)).to_pylist()
    return [_rollout(row, f"{path}: row {index}") for index, row in enumerate(rows)]


def _row(rollout: Rollout, timings: bool) -> dict[str, Any]:
    values = rollout.to_dict()
    return {
        **{name: values[name] for name in (*_TEXTS, *_NUMBERS, *_MEASURES, *_TIMES)},
        **{name: getattr(rollout, name).reshape(-1) for name in _ARRAYS},
        **values["incidents"],
        **{name: json.dumps(values[name], allow_nan=False) for name in _RECORDS if timings or name != "timings"},
    }


def _rollout(row: dict[str, Any], where: str) -> Rollout:
    try:
        records = {name: json.loads(row[name]) for name in _RECORDS if row[name] is not None}
        rollout = Rollout.from_dict(
            {
                **{name: row[name] for name in (*_TEXTS, *_NUMBERS, *_MEASURES, *_TIMES, *_ARRAYS)},
                "controls": [row["controls"][start : start + 2] for start in range(0, len(row["controls"]), 2)],
                "incidents": {name: row[name] for name in INCIDENTS},
                **records,
            }
        )
    except (InputError, TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{where}: {error}") from error
    count = len(rollout.timestamps_us)
    if rollout.states.shape != (count, STATE_SIZE) or rollout.heights.shape != (count,):
        raise InputError(f"{where}: states and heights do not fit {count} times; simulate it again")
    return rollout
