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
    """A composed mixture, or a recipe composed of clip stores; InputError where it is not either of them."""
    from olt_datasets import compose_mixture, find_recipe, read_clip_tables, read_mixture
    from olt_generator.errors import InputError
    from olt_toolkit.recordings.recording import refuse_unused

    if mixture is not None and recipe is None:
        refuse_unused({"--allow-uncompared": allow_uncompared}, "a mixture was compared when it was composed")
        return read_mixture(mixture)
    if recipe is not None and mixture is None and stores:
        return compose_mixture(
            find_recipe(recipe),
            read_clip_tables(stores),
            seed or 0,
            held_out_scenes=held_out_scenes,
            allow_uncompared=allow_uncompared,
        )
    raise InputError("give either --mixture FILE, or --recipe NAME with --stores DIR")
