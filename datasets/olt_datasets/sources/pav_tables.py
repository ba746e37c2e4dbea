"""The tables of a PhysicalAI-AV tree that tell what each clip is (docs/formats/physicalai_av.md)."""

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd

from olt_generator.errors import InputError
from olt_toolkit.clips.clip import check_clip_id
from olt_toolkit.clips.pai_layout import CLIP_INDEX, DATA_COLLECTION, FEATURE_PRESENCE, FEATURES
from olt_toolkit.clips.pai_tables import read_indexed
from olt_toolkit.recordings.labels import UNLABELLED, Split

REASONING = "reasoning/ood_reasoning.parquet"
OLDER_FEATURE_PRESENCE = "metadata/sensor_presence.parquet"

# The countries of the data set as it names them.
_COUNTRY_CODES = {
    "Austria": "AT",
    "Belgium": "BE",
    "Bulgaria": "BG",
    "Croatia": "HR",
    "Czechia": "CZ",
    "Denmark": "DK",
    "Estonia": "EE",
    "Finland": "FI",
    "France": "FR",
    "Germany": "DE",
    "Greece": "GR",
    "Hungary": "HU",
    "Italy": "IT",
    "Latvia": "LV",
    "Lithuania": "LT",
    "Luxembourg": "LU",
    "Netherlands": "NL",
    "Poland": "PL",
    "Portugal": "PT",
    "Romania": "RO",
    "Slovakia": "SK",
    "Slovenia": "SI",
    "Spain": "ES",
    "Sweden": "SE",
    "United States": "US",
}


@dataclass(frozen=True)
class IndexedClip:
    """What the clip index tells: the chunk that holds a clip, its split, and times to learn from in clip time."""

    chunk: int
    split: Split
    event_t0s_us: tuple[int, ...]


@dataclass(frozen=True)
class ClipEvents:
    """What the reasoning table tells: times of a clip's events in clip time, and its long-tail category."""

    times_us: tuple[int, ...] = ()
    category: str = UNLABELLED


def read_clip_index(root: Path) -> dict[str, IndexedClip]:
    """The clips that are valid, by id; InputError names a column that is missing or of another type."""
    path = root / CLIP_INDEX
    table = read_indexed(path, ["chunk", "split", "clip_is_valid"], ["clip_id"])
    for column, kind in {"chunk": np.int64, "clip_is_valid": np.bool_}.items():
        if table[column].dtype != kind:
            raise InputError(f"{path}: column {column} is {table[column].dtype}; it must be {np.dtype(kind)}")
    unknown = set(table.loc[table["clip_is_valid"], "split"]) - set(get_args(Split))
    if unknown:
        raise InputError(
            f"{path}: column split holds {unknown.pop()!r}; it must be one of {', '.join(get_args(Split))}"
        )
    event_t0s = table["event_t0s"].tolist() if "event_t0s" in table else [()] * len(table)
    rows = zip(table.index, table["clip_is_valid"], table["chunk"], table["split"], event_t0s, strict=True)
    return {
        check_clip_id(clip_id, str(path)): IndexedClip(
            int(chunk), split, _integers(times, f"{path}: clip {clip_id}: event_t0s")
        )
        for clip_id, valid, chunk, split, times in rows
        if valid
    }


def read_absence(root: Path) -> dict[str, frozenset[str]]:
    """The clips that lack a feature, by feature; empty where no table tells, InputError where it is damaged."""
    for name in (FEATURE_PRESENCE, OLDER_FEATURE_PRESENCE):
        if (root / name).is_file():
            table = read_indexed(root / name, [], ["clip_id"])
            known = [feature for feature in FEATURES if feature in table]
            return {feature: frozenset(table.index[~table[feature].to_numpy(bool)]) for feature in known}
    return {}


def read_countries(root: Path) -> dict[str, str]:
    """Country codes of two letters by clip, where the tree tells one; InputError where it is none of the data set."""
    path = root / DATA_COLLECTION
    if not path.is_file():
        return {}
    named = read_indexed(path, ["country"], ["clip_id"])["country"].dropna()
    countries = {str(clip_id): str(country) for clip_id, country in named.items()}
    unknown = set(countries.values()) - set(_COUNTRY_CODES)
    if unknown:
        raise InputError(f"{path}: column country holds {unknown.pop()!r}, which is no country of the data set")
    return {clip_id: _COUNTRY_CODES[country] for clip_id, country in countries.items()}


def read_events(root: Path) -> dict[str, ClipEvents]:
    """Events and category of the clips that a reasoning table has; InputError names the clip where it is damaged."""
    path = root / REASONING
    if not path.is_file():
        return {}
    table = read_indexed(path, ["events"], ["clip_id"])
    clusters = table["event_cluster"] if "event_cluster" in table else pd.Series(None, table.index, "string")
    found = {}
    for clip_id, events, cluster in zip(table.index, table["events"], clusters, strict=True):
        # The name of a cluster of events as categories are written.
        words = re.sub(r"[^a-z0-9]+", "_", cluster.lower()).strip("_") if isinstance(cluster, str) else ""
        found[str(clip_id)] = ClipEvents(_event_times(events, f"{path}: clip {clip_id}"), words or UNLABELLED)
    return found


def _event_times(events: Any, where: str) -> tuple[int, ...]:
    """Starts of events, which are JSON text or a list of objects."""
    try:
        listed = json.loads(events) if isinstance(events, str) else list(events)
        times = [event["event_start_timestamp"] for event in listed]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise InputError(f"{where}: events must list objects with event_start_timestamp ({error})") from error
    return _integers(times, f"{where}: event_start_timestamp")


def _integers(times: Iterable[Any] | None, where: str) -> tuple[int, ...]:
    times = () if times is None else tuple(times)
    for time in times:
        if not isinstance(time, (int, np.integer)) or isinstance(time, bool):
            raise InputError(f"{where} holds {time}; it must hold integer microseconds")
    return tuple(int(time) for time in times)
