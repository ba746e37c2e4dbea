"""Recipes: what goes into a training mixture, written in YAML.

A recipe names a split and components. Each component filters the clip table and asks for a share of the epoch or for
a count of samples, the same way in all components of one recipe.
"""

import math
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from olt_generator.errors import InputError
from olt_toolkit.yaml_files import read_yaml_mapping

RECIPE_VERSION = 1
RECIPE_SUFFIXES = (".yaml", ".yml")

# Lists are read as tuples, so that a recipe cannot change after it was checked.
Words = Annotated[tuple[str, ...], Field(strict=False)]


class Filter(BaseModel):
    """Which clips of the table a component may use; every condition given must hold.

    Attributes:
        kind: "GT" (measured views), "Syn" (synthesized views), or "any" of the two.
        source: the clip's source is one of these; empty for every source.
        category: the clip's category is one of these; empty for every category.
        category_not: the clip's category is none of these.
        factors_any, factors_all, factors_none: the clip has at least one, all, none of these scene factors.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    kind: Literal["GT", "Syn", "any"] = "any"
    source: Words = ()
    category: Words = ()
    category_not: Words = ()
    factors_any: Words = ()
    factors_all: Words = ()
    factors_none: Words = ()

    def __str__(self) -> str:
        conditions = self.model_dump(mode="json", exclude_defaults=True)
        return "{" + ", ".join(f"{name}: {_flow(value)}" for name, value in conditions.items()) + "}"


class Component(BaseModel):
    """One part of a mixture.

    Attributes:
        name: unique in the recipe; it also seeds the draw, so that components of one name draw alike in all recipes.
        where: which clips it may use.
        share: its part of the epoch, between 0 and 1; or
        count: its number of samples per epoch.
        repeats: how often one sample may be used per epoch.
        prefer: which kind to keep of a scene that has clips of both kinds; None keeps both.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    name: str = Field(min_length=1)
    where: Filter = Filter()
    share: float | None = Field(default=None, gt=0.0, le=1.0)
    count: int | None = Field(default=None, gt=0)
    repeats: int = Field(default=1, ge=1)
    prefer: Literal["GT", "Syn"] | None = None

    @model_validator(mode="after")
    def _check(self) -> "Component":
        if (self.share is None) == (self.count is None):
            raise ValueError("give exactly one of 'share' and 'count'")
        if self.prefer is not None and self.where.kind != "any":
            raise ValueError(f"'prefer' chooses between kinds, but 'where' asks for kind {self.where.kind} only")
        return self


class Recipe(BaseModel):
    """What goes into a mixture.

    Attributes:
        name, description: for people.
        version: version of the recipe format.
        split: the split that samples are drawn from.
        samples: samples per epoch of a recipe with shares; None for as many as the scarcest component allows.
        components: the parts; shares sum to 1.
        held_out_scenes: scene ids whose clips are left out, whatever their split.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    name: str = Field(min_length=1)
    description: str
    version: int
    split: Literal["train", "val", "test"] = "train"
    samples: int | None = Field(default=None, gt=0)
    components: Annotated[tuple[Component, ...], Field(strict=False)]
    held_out_scenes: Words = ()

    @model_validator(mode="after")
    def _check(self) -> "Recipe":
        if self.version != RECIPE_VERSION:
            raise ValueError(
                f"version {self.version} of the recipe format is not known; this release reads {RECIPE_VERSION}"
            )
        if not self.components:
            raise ValueError("'components' is empty; a mixture needs at least one")
        names = [component.name for component in self.components]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"two components are called {twice[0]!r}; give each its own name")
        shares = [component.share for component in self.components if component.share is not None]
        if shares and len(shares) != len(names):
            raise ValueError("some components give 'share' and some 'count'; use the same in all of them")
        if shares and not math.isclose(math.fsum(shares), 1.0, abs_tol=1e-6):
            raise ValueError(f"the shares sum to {math.fsum(shares):.6g}; change them to sum to 1")
        if not shares and self.samples is not None:
            raise ValueError("'samples' follows from the counts of the components; remove it")
        return self


def read_recipe(path: Path) -> Recipe:
    """Read and check a recipe.

    Raises:
        InputError: the file cannot be read, is not YAML, or a field is wrong; names the file and the field.
    """
    return parse_recipe(read_yaml_mapping(path, "recipe", Recipe.model_fields), str(path))


def parse_recipe(content: dict[Any, Any], where: str) -> Recipe:
    """Check the content of a recipe; `where` names it in errors.

    Raises:
        InputError: the first field that is wrong.
    """
    try:
        return Recipe.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise InputError(f"{where}: {_explain(first['type'], first['loc'], first['msg'], first['input'])}") from error


def builtin_recipes() -> list[str]:
    """Names of the recipes that come with the package."""
    folder = files("olt_datasets") / "recipes"
    return sorted(Path(entry.name).stem for entry in folder.iterdir() if entry.name.endswith(RECIPE_SUFFIXES))


def builtin_recipe(name: str) -> Recipe:
    """A recipe that comes with the package.

    Raises:
        InputError: there is none of this name.
    """
    if name not in builtin_recipes():
        raise InputError(f"no built-in recipe {name!r}; there are {', '.join(builtin_recipes())}, or give a YAML file")
    text = (files("olt_datasets") / "recipes" / f"{name}.yaml").read_text(encoding="utf-8")
    return parse_recipe(yaml.safe_load(text), f"built-in recipe {name}")


def find_recipe(path_or_name: str) -> Recipe:
    """The recipe in a YAML file, or the built-in one of this name.

    Raises:
        InputError: neither exists, or the recipe is wrong.
    """
    if path_or_name.endswith(RECIPE_SUFFIXES):
        return read_recipe(Path(path_or_name))
    return builtin_recipe(path_or_name)


def _explain(kind: str, location: Sequence[str | int], message: str, value: object) -> str:
    field = _field_name(location)
    if kind == "extra_forbidden":
        return f"unknown key {field!r}; known here: {_known(_model_at(location))}"
    if kind == "missing":
        return f"key {field!r} is missing; add it"
    prefix = f"{field}: " if field else ""
    if kind == "value_error":
        return prefix + message.removeprefix("Value error, ")
    if kind == "tuple_type":
        return f"{prefix}write a list, such as [{value}]"
    if kind == "model_type":
        return f"{prefix}write a mapping, got {value!r}"
    return f"{prefix}{message[0].lower()}{message[1:]}, got {value!r}"


def _field_name(location: Sequence[str | int]) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).removeprefix(".")


def _model_at(location: Sequence[str | int]) -> type[BaseModel]:
    parents = location[:-1]
    if "where" in parents:
        return Filter
    return Component if "components" in parents else Recipe


def _known(model: type[BaseModel]) -> str:
    return ", ".join(model.model_fields)


def _flow(value: object) -> str:
    return "[" + ", ".join(map(str, value)) + "]" if isinstance(value, list) else str(value)
