"""Driving data sets: tables of their clips, training mixtures of these, and exports for public recipes.

What a user of the package needs is here by name, and loaded when it is first asked for.
"""

from typing import TYPE_CHECKING

from olt_generator.lazy_names import lazy_names

if TYPE_CHECKING:
    from olt_datasets.export.contents import contents_of_mixture as contents_of_mixture
    from olt_datasets.export.contents import contents_of_stores as contents_of_stores
    from olt_datasets.export.lerobot import export_lerobot as export_lerobot
    from olt_datasets.export.pai import export_pai as export_pai
    from olt_datasets.mixtures.comparison import compare_mixtures as compare_mixtures
    from olt_datasets.mixtures.dataset import MixtureBatchSampler as MixtureBatchSampler
    from olt_datasets.mixtures.dataset import MixtureDataset as MixtureDataset
    from olt_datasets.mixtures.mixture import Mixture as Mixture
    from olt_datasets.mixtures.mixture import check_recipe as check_recipe
    from olt_datasets.mixtures.mixture import compose_mixture as compose_mixture
    from olt_datasets.mixtures.mixture_file import read_mixture as read_mixture
    from olt_datasets.mixtures.mixture_file import write_mixture as write_mixture
    from olt_datasets.mixtures.recipe import Recipe as Recipe
    from olt_datasets.mixtures.recipe import find_recipe as find_recipe
    from olt_datasets.mixtures.recipe import read_recipe as read_recipe
    from olt_datasets.mixtures.source_alignment import align_sources as align_sources
    from olt_datasets.mixtures.source_alignment import measure_coverage as measure_coverage
    from olt_datasets.tables.clip_frame import read_clip_tables as read_clip_tables
    from olt_datasets.tables.clip_frame import scan_clip_tables as scan_clip_tables
    from olt_datasets.tables.indexing import index_dataset as index_dataset
    from olt_datasets.tables.labels import label_table as label_table
    from olt_datasets.tables.leaks import find_leaks as find_leaks
    from olt_datasets.tables.splits import split_table as split_table

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "export.contents": ("contents_of_mixture", "contents_of_stores"),
        "export.lerobot": ("export_lerobot",),
        "export.pai": ("export_pai",),
        "mixtures.comparison": ("compare_mixtures",),
        "mixtures.dataset": ("MixtureBatchSampler", "MixtureDataset"),
        "mixtures.mixture": ("Mixture", "check_recipe", "compose_mixture"),
        "mixtures.mixture_file": ("read_mixture", "write_mixture"),
        "mixtures.recipe": ("Recipe", "find_recipe", "read_recipe"),
        "mixtures.source_alignment": ("align_sources", "measure_coverage"),
        "tables.clip_frame": ("read_clip_tables", "scan_clip_tables"),
        "tables.indexing": ("index_dataset",),
        "tables.labels": ("label_table",),
        "tables.leaks": ("find_leaks",),
        "tables.splits": ("split_table",),
    },
)
