"""A composed mixture as a file: everything that training needs to repeat it without the clip table."""

from pathlib import Path
from typing import Any, Literal

import polars as pl
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from olt_datasets.mixture import GROUPS, KEY_COLUMNS, Mixture, MixtureComponent
from olt_datasets.recipe import Recipe
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_toolkit import __version__

PLAN_SUFFIX = ".json"


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class _Samples(_Strict):
    """Columns of equal length; `store` counts into the stores of the plan."""

    store: list[int]
    clip_id: list[str]
    t0_us: list[int]
    kind: list[str]
    category: list[str]
    source: list[str]

    @model_validator(mode="after")
    def _check(self) -> "_Samples":
        if len({len(column) for _, column in self}) > 1 or not self.store:
            raise ValueError("the columns are empty or differ in length")
        return self


class _PlannedComponent(_Strict):
    asked: float
    got: int
    available: int
    samples: _Samples


class _Plan(_Strict):
    format: Literal["openlongtail mixture"] = "openlongtail mixture"
    version: Literal[1] = 1
    created_with: str = __version__
    recipe: Recipe
    seed: int
    table_checksum: str
    stores: list[str]
    components: list[_PlannedComponent]
    summary: dict[str, Any]

    @model_validator(mode="after")
    def _check(self) -> "_Plan":
        if len(self.components) != len(self.recipe.components):
            raise ValueError("the recipe and the plan differ in their number of components")
        if any(not 0 <= store < len(self.stores) for part in self.components for store in part.samples.store):
            raise ValueError("a sample is of a store that is not listed")
        return self


def write_plan(mixture: Mixture, path: Path) -> None:
    """Write a mixture as JSON; the file appears whole.

    Raises:
        InputError: the name does not end in `.json`, or the folder cannot be written to.
    """
    if path.suffix != PLAN_SUFFIX:
        raise InputError(f"{path}: a mixture is written as JSON; give a name that ends in {PLAN_SUFFIX}")
    stores = sorted({store for part in mixture.components for store in part.samples["store"].unique()})
    plan = _Plan(
        recipe=mixture.recipe,
        seed=mixture.seed,
        table_checksum=mixture.table_checksum,
        stores=stores,
        components=[_plan_component(part, stores) for part in mixture.components],
        summary=mixture.describe(),
    )
    with write_whole(path) as temporary:
        temporary.write_text(plan.model_dump_json() + "\n", encoding="utf-8")


def read_plan(path: Path) -> Mixture:
    """Read a mixture that `write_plan` wrote.

    Raises:
        InputError: the file cannot be read or is not a plan of this version; names the field.
    """
    try:
        plan = _Plan.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot read this mixture ({error.strerror})") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"])) or "file"
        raise InputError(f"{path}: {field}: {first['msg']}; compose the mixture again") from error
    components = [_read_component(plan, index, component) for index, component in enumerate(plan.components)]
    return Mixture(plan.recipe, plan.seed, plan.table_checksum, tuple(components))


def _plan_component(part: MixtureComponent, stores: list[str]) -> _PlannedComponent:
    columns = part.samples.with_columns(
        pl.col("store").replace_strict(stores, range(len(stores)), return_dtype=pl.Int64)
    )
    samples = _Samples(**columns.to_dict(as_series=False))
    return _PlannedComponent(asked=part.asked, got=part.got, available=part.available, samples=samples)


def _read_component(plan: _Plan, index: int, part: _PlannedComponent) -> MixtureComponent:
    columns = part.samples.model_dump() | {"store": [plan.stores[store] for store in part.samples.store]}
    samples = pl.DataFrame(columns).select(*KEY_COLUMNS, *GROUPS)
    return MixtureComponent(plan.recipe.components[index], part.asked, part.got, part.available, samples)
