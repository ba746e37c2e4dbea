"""Near-duplicates: clips whose front images show one drive, found by their fingerprints (`clips.fingerprint`).

For each clip of one list, a like clip of another is looked for: thumbnails that look alike meet under keys
(`thumbnail_keys`), the clips that share most keys are laid on each other in space and time (`thumbnail_alignment`), and
the first that is alike is told. So time and memory grow with the number of clips, also where thousands look alike: of
thumbnails that share a key, a few are taken, and clips for which that left some out without finding a like one are
counted (`Search.crowded`).
"""

from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.tables.thumbnail_alignment import find_likeness
from olt_datasets.tables.thumbnail_candidates import find_candidates
from olt_datasets.tables.thumbnail_index import Index, Thumbnails, build_indexes, is_telling, read_thumbnails
from olt_datasets.tables.thumbnail_keys import choose_effort
from olt_toolkit.clips.fingerprint import IMAGES

__all__ = ["Search", "find_near_duplicates", "is_telling", "search_near_duplicates"]

_PROBES_AT_ONCE = 1 << 19

Pairs = NDArray[np.int64]
Places = NDArray[np.int64]


@dataclass(frozen=True)
class Search:
    """What a search has found.

    Attributes:
        pairs: places (m, 2), ascending, of clips of the first list and of a like clip of the second: one at most each.
        matches: (m,) how alike each pair is: `score` (`thumbnail_alignment.Likeness`), `lag_s`, how many seconds later
            the second shows what the first shows, and `mirrored`.
        crowded: places (c,) of clips of the first list that share many keys with more clips than are compared, and for
            which no like clip is among those compared: not compared in full.
    """

    pairs: Pairs
    matches: pl.DataFrame
    crowded: Places


def find_near_duplicates(
    first: pl.Series, second: pl.Series, first_scenes: pl.Series | None = None, second_scenes: pl.Series | None = None
) -> Pairs:
    """Places (m, 2), ascending, of clips of a list and of a like clip of another: not all pairs, one for each clip.

    Args:
        first, second: fingerprints, None where a clip has none.
        first_scenes, second_scenes: names of the clips' scenes; clips of one scene are no pair.
    """
    return search_near_duplicates(_frame(first, first_scenes), _frame(second, second_scenes)).pairs


def search_near_duplicates(first: pl.LazyFrame, second: pl.LazyFrame) -> Search:
    """For each clip of a table, a like clip of another scene in another table, with what was not compared.

    Tables have columns `fingerprint` and `scene_id`, and are read in parts: at most half a million clips of the second
    are held at once, and the first is read once for each of these blocks.
    """
    clips = second.select(pl.len()).collect(engine="streaming").item()
    effort = choose_effort(clips)
    found = _Found(first.select(pl.len()).collect(engine="streaming").item())
    for index in build_indexes(second, effort):
        for part in read_thumbnails(first, _PROBES_AT_ONCE // (IMAGES * effort.probes * effort.tables)):
            _search_part(part, index, found)
    return found.to_search()


class _Found:
    """What has been found for each clip of a table so far: the place of a like clip or -1, and how alike it is."""

    def __init__(self, clips: int) -> None:
        self.others = np.full(clips, -1, np.int32)
        self.scores, self.lags_s = np.zeros(clips, np.float32), np.zeros(clips, np.float32)
        self.mirrored, self.crowded = np.zeros(clips, bool), np.zeros(clips, bool)

    def to_search(self) -> Search:
        places = np.flatnonzero(self.others >= 0)
        columns = {"score": self.scores[places], "lag_s": self.lags_s[places], "mirrored": self.mirrored[places]}
        pairs = np.stack([places, self.others[places].astype(np.int64)], axis=1)
        return Search(pairs, pl.DataFrame(columns), np.flatnonzero(self.crowded & (self.others < 0)))


def _frame(fingerprints: pl.Series, scenes: pl.Series | None) -> pl.LazyFrame:
    names = pl.Series([None], dtype=pl.String).new_from_index(0, len(fingerprints)) if scenes is None else scenes
    return pl.LazyFrame({"fingerprint": fingerprints.cast(pl.Binary), "scene_id": names})


def _search_part(part: Thumbnails, index: Index, found: _Found) -> None:
    """Add a like clip for each of those that have none yet, and mark those not compared in full."""
    candidates = find_candidates(part, index)
    found.crowded[part.clips[candidates.crowded]] = True
    for clip, other, mirrored in zip(candidates.clips, candidates.others, candidates.mirrored, strict=True):
        place = part.clips[clip]
        if found.others[place] >= 0:
            continue
        mine = part.sequence(clip)
        likeness = find_likeness(mine.mirrored if mirrored else mine, index.thumbnails.sequence(other))
        if likeness is not None:
            found.others[place] = index.thumbnails.clips[other]
            found.scores[place], found.lags_s[place], found.mirrored[place] = likeness.score, likeness.lag_s, mirrored
