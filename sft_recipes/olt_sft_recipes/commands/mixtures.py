"""The mixture that a command trains on."""

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from olt_datasets import Mixture


def choose_mixture(
    mixture: Path | None,
    recipe: str | None,
    stores: list[Path],
    seed: int | None,
    allow_uncompared: bool,
    held_out_scenes: Collection[str] = (),
) -> "Mixture":
    """A composed mixture, or a recipe composed of clip stores.

    Raises:
        InputError: it is not either of them, it cannot be read or composed, or it shows a held-out scene.
    """
    from olt_datasets import compose_mixture, find_recipe, read_clip_tables, read_mixture
    from olt_generator.errors import InputError
    from olt_toolkit.recordings.recording import refuse_unused

    if mixture is not None and recipe is None:
        refuse_unused({"--allow-uncompared": allow_uncompared}, "a mixture was compared when it was composed")
        composed = read_mixture(mixture)
        _refuse_scenes(composed, held_out_scenes, mixture)
        return composed
    if recipe is not None and mixture is None and stores:
        return compose_mixture(
            find_recipe(recipe),
            read_clip_tables(stores),
            seed or 0,
            held_out_scenes=held_out_scenes,
            allow_uncompared=allow_uncompared,
        )
    raise InputError("give either --mixture FILE, or --recipe NAME with --stores DIR")


def _refuse_scenes(mixture: "Mixture", scenes: Collection[str], path: Path) -> None:
    """Refuse a mixture with clips of these scenes: which they show, their stores tell."""
    from olt_generator.errors import InputError
    from olt_toolkit import ClipStore

    if not scenes:
        return
    clips = mixture.samples.select("store", "clip_id").unique()
    stores = {store: ClipStore(Path(store)) for store in clips["store"].unique()}
    shown = {stores[store].info(clip_id).scene_id for store, clip_id in clips.iter_rows()} & {*scenes}
    if shown:
        raise InputError(
            f"{path}: trains on {', '.join(sorted(shown))}, which is kept to judge by; compose it again, with this in "
            "held_out_scenes of its recipe"
        )
