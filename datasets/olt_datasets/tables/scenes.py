"""Scenes that people name, held against those that a table of clips has."""

from collections.abc import Collection

import polars as pl

from olt_generator.errors import InputError

_SHOWN = 3


def refuse_unknown_scenes(table: pl.DataFrame | pl.LazyFrame, scene_ids: Collection[str], where: str) -> None:
    """Refuse (`InputError`) scene ids that no clip of the table has: a scene that is held out by them is not.

    `where` names what holds the ids out, such as an option.
    """
    if not scene_ids:
        return
    named = pl.col("scene_id").filter(pl.col("scene_id").is_in(list(scene_ids))).unique()
    known = set(table.lazy().select(named).collect(engine="streaming")["scene_id"])
    unknown = [scene_id for scene_id in scene_ids if scene_id not in known]
    if unknown:
        more = f" and {len(unknown) - _SHOWN} more" if len(unknown) > _SHOWN else ""
        raise InputError(
            f"{where}: no clip shows {', '.join(map(repr, unknown[:_SHOWN]))}{more}, so this holds nothing out; give "
            "ids of the column scene_id, which are others than those of older releases"
        )
