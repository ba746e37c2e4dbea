"""Recipes: what goes into a training mixture, written in YAML.

A recipe names a split and components. Each component filters the clip table and asks for a share of the epoch or for
a count of samples, the same way in all components of one recipe. Shares may change from epoch to epoch: a curriculum.

    name: cyclists_first
    description: Long-tail drives grow from a tenth to a half of each epoch.
    version: 1
    samples: 12000
    components:
      - name: nominal
        where: {kind: GT, category: [nominal]}
        share_by_epoch: {0: 0.9, 2: 0.5}
        t0: keyframe
      - name: long_tail
        where: {category_not: [nominal], country: [US, DE]}
        share_by_epoch: {0: 0.1, 2: 0.5}
        prefer: GT
        repeats: 4
        samples_per_clip: 3
        caps: {cyclists: 500}
"""

import math
from bisect import bisect_right
from fractions import Fraction
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from olt_generator.errors import InputError
from olt_toolkit.recordings.labels import Split
from olt_toolkit.runtime.yaml_files import parse_yaml, read_yaml_mapping

RECIPE_VERSION = 1
RECIPE_SUFFIXES = (".yaml", ".yml")

# What is beyond these is a slip of the pen, and would take hours or all memory before it showed.
MOST_ITEMS = 100_000_000
MOST_EPOCHS = 10_000
MOST_COMPONENTS = 256
_MOST_CAPS = 1000
_LONGEST_NAME, _LONGEST_TEXT = 200, 10_000
# Characters of a wrong value that an error shows.
_SHOWN = 80

# Lists are read as tuples, so that a recipe cannot change after it was checked.
Word = Annotated[str, Field(max_length=_LONGEST_TEXT)]
Name = Annotated[str, Field(min_length=1, max_length=_LONGEST_NAME, pattern=r"^[^\x00-\x1f\x7f]*$")]
Words = Annotated[tuple[Word, ...], Field(strict=False)]
FactorWords = Annotated[tuple[Word, ...], Field(strict=False, max_length=_MOST_CAPS)]
Count = Annotated[int, Field(gt=0, le=MOST_ITEMS)]
EpochShares = dict[Annotated[int, Field(ge=0, le=MOST_EPOCHS)], Annotated[float, Field(ge=0.0, le=1.0)]]
Caps = Annotated[dict[str, Count], Field(max_length=_MOST_CAPS)]


# Fields of a filter that limit what was measured of a clip or, for the last, of a sample; `quality` knows the numbers.
LIMITS = (
    "observed_share_min",
    "invented_share_max",
    "unseen_share_max",
    "acceleration_noise_max",
    "action_error_max",
)
Weighed = Literal["invented_share", "unseen_share", "acceleration_noise", "action_error"]
Halvings = dict[Weighed, Annotated[float, Field(gt=0.0, allow_inf_nan=False)]]


class Filter(BaseModel):
    """Which clips of the table a component may use; every condition given must hold.

    Attributes:
        kind: "GT" (measured views), "Syn" (synthesized views), or "any" of the two.
        source, country, category: the clip's is one of these; empty for every one, told or not.
        category_not: the clip's category is none of these.
        factors_any, factors_all, factors_none: the clip has at least one, all, none of these scene factors.
        doubts: "none" leaves out clips of which something is in doubt, such as the direction of their motion; "any"
            takes them. Clips that are only indexed, so that nobody looked, have none yet.
        observed_share_min, invented_share_max, unseen_share_max: the clip has at least or at most this share of pixels
            that cameras saw, that are made up, that are black; over all its views.
        acceleration_noise_max: its acceleration labels are expected to err by so many m/s2 at most.
        action_error_max: of its samples those alone whose future is so many metres at most from what the policy's
            actions can express.
        not_measured: whether clips of which a number is asked for, here or in `weight_by`, and was not measured are
            left out, or taken as if it were fine.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    kind: Literal["GT", "Syn", "any"] = "any"
    source: Words = ()
    country: Words = ()
    category: Words = ()
    category_not: Words = ()
    factors_any: FactorWords = ()
    factors_all: FactorWords = ()
    factors_none: FactorWords = ()
    doubts: Literal["none", "any"] = "none"
    observed_share_min: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    invented_share_max: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    unseen_share_max: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    acceleration_noise_max: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] | None = None
    action_error_max: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] | None = None
    not_measured: Literal["leave_out", "take"] = "leave_out"

    @property
    def limits(self) -> dict[str, float]:
        """The limits that are given, by the name of their field."""
        given = {name: getattr(self, name) for name in LIMITS}
        return {name: limit for name, limit in given.items() if limit is not None}

    def without_limits(self) -> "Filter":
        """The same conditions but for the limits."""
        return self.model_copy(update=dict.fromkeys(LIMITS))

    def __str__(self) -> str:
        conditions = self.model_dump(exclude_defaults=True)
        words = {
            name: f"[{', '.join(value)}]" if isinstance(value, tuple) else value for name, value in conditions.items()
        }
        return "{" + ", ".join(f"{name}: {text}" for name, text in words.items()) + "}"


class Component(BaseModel):
    """One part of a mixture; it gives exactly one of `share`, `share_by_epoch` and `count`.

    Attributes:
        name: unique in the recipe; it also seeds the draw, so that components of one name draw alike in all recipes.
        where: which clips it may use.
        share: its part of every epoch, between 0 and 1.
        share_by_epoch: its part of some epochs, the first among them 0; see `Recipe.between_epochs` for the others.
            The last one named holds from there on.
        count: its number of samples per epoch.
        repeats: how often one sample may be used per epoch.
        t0: which sample times of a clip are used: "every", or the "keyframe", the one nearest to 5.1 s, as the public
            loader takes it.
        samples_per_clip: at most so many of them in a clip, spread evenly; None for no limit.
        prefer: which kind to use where GT and Syn clips show the same scene in the same time window: "GT" takes
            measured views where there are any and synthesized ones elsewhere. None uses both.
        caps: by category, the most samples that may be used.
        weight_by: what makes a sample less likely to be drawn, and how much of it halves its weight: with
            `{invented_share: 0.3}` a sample of 0.6 is drawn a quarter as readily as one of 0. Several numbers multiply.
            Where all samples are drawn, weights choose nothing; they change no loss.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    name: Name
    where: Filter = Filter()
    share: float | None = Field(default=None, gt=0.0, le=1.0)
    share_by_epoch: EpochShares | None = None
    count: Count | None = None
    repeats: Count = 1
    t0: Literal["every", "keyframe"] = "every"
    samples_per_clip: Count | None = None
    prefer: Literal["GT", "Syn"] | None = None
    caps: Caps = {}
    weight_by: Halvings = {}

    @model_validator(mode="after")
    def _check(self) -> "Component":
        if [self.share, self.share_by_epoch, self.count].count(None) != 2:
            raise ValueError("give exactly one of 'share', 'share_by_epoch' and 'count'")
        if self.share_by_epoch is not None and 0 not in self.share_by_epoch:
            raise ValueError("'share_by_epoch' does not say the share of epoch 0; add it")
        if self.share_by_epoch is not None and not any(self.share_by_epoch.values()):
            raise ValueError("'share_by_epoch' is 0 in every epoch; remove the component")
        if self.t0 == "keyframe" and self.samples_per_clip is not None:
            raise ValueError("'t0: keyframe' is one sample per clip; remove 'samples_per_clip'")
        if self.where.not_measured == "take" and not (self.where.limits or self.weight_by):
            raise ValueError("'not_measured' is for limits and 'weight_by'; add one or remove it")
        if self.prefer is not None and self.where.kind != "any":
            raise ValueError(f"'prefer' chooses between kinds, but 'where' asks for kind {self.where.kind} only")
        return self

    @property
    def named_epochs(self) -> list[int]:
        """The epochs whose share is written down, in order; empty for a component with a count."""
        return sorted(self._epoch_shares)

    def share_at(self, epoch: int, between: Literal["linear", "steps"]) -> Fraction:
        """The share of an epoch, as the decimal fractions of the recipe give it."""
        epochs = self.named_epochs
        after = bisect_right(epochs, epoch)
        start = epochs[after - 1]
        share = Fraction(str(self._epoch_shares[start]))
        if between == "steps" or after == len(epochs):
            return share
        progress = Fraction(epoch - start, epochs[after] - start)
        return share + progress * (Fraction(str(self._epoch_shares[epochs[after]])) - share)

    @property
    def _epoch_shares(self) -> EpochShares:
        return self.share_by_epoch or ({} if self.share is None else {0: self.share})


class Recipe(BaseModel):
    """What goes into a mixture.

    Attributes:
        name, description: for people.
        version: version of the recipe format.
        split: the split that samples are drawn from.
        samples: samples per epoch of a recipe with shares; None for as many as the scarcest component allows.
        components: the parts; shares sum to 1 in every epoch. None at all is a recipe for a base model that is
            evaluated as it is: its mixture has no samples, and training on it is refused.
        between_epochs: how shares go from one named epoch to the next: in equal steps each epoch ("linear"), or at
            once when it comes ("steps").
        held_out_scenes: scene ids whose clips are left out, whatever their split; ids that no clip has are refused.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    name: Name
    description: Annotated[str, Field(max_length=_LONGEST_TEXT)]
    version: int
    split: Split = "train"
    samples: Count | None = None
    components: Annotated[tuple[Component, ...], Field(strict=False, max_length=MOST_COMPONENTS)]
    between_epochs: Literal["linear", "steps"] = "linear"
    held_out_scenes: Words = ()

    @model_validator(mode="after")
    def _check(self) -> "Recipe":
        if self.version != RECIPE_VERSION:
            raise ValueError(
                f"version {self.version} of the recipe format is not known; this release reads {RECIPE_VERSION}"
            )
        names = [component.name for component in self.components]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"two components are called {twice[0]!r}; give each its own name")
        counted = [component.count is not None for component in self.components]
        if any(counted) and not all(counted):
            raise ValueError("some components give 'share' and some 'count'; use the same in all of them")
        if all(counted) and self.samples is not None:
            raise ValueError("'samples' follows from the counts of the components; remove it")
        for epoch in self.named_epochs:
            total = math.fsum(component.share_at(epoch, self.between_epochs) for component in self.components)
            if not math.isclose(total, 1.0, abs_tol=1e-6):
                when = f" in epoch {epoch}" if len(self.named_epochs) > 1 else ""
                raise ValueError(f"the shares sum to {total:.6g}{when}; change them to sum to 1")
        return self

    @property
    def named_epochs(self) -> list[int]:
        """The epochs at which some share is written down, in order; between them shares are linear or constant."""
        return sorted({epoch for component in self.components for epoch in component.named_epochs})

    def shares(self, epoch: int) -> list[Fraction]:
        """The exact shares of the components in an epoch, summing to exactly 1."""
        shares = [component.share_at(epoch, self.between_epochs) for component in self.components]
        return [share / sum(shares) for share in shares]


def read_recipe(path: Path) -> Recipe:
    """Read and check a recipe.

    Raises:
        InputError: the file cannot be read, is not YAML, or a field is wrong; names the file and the field.
    """
    return parse_recipe(read_yaml_mapping(path, "recipe", Recipe.model_fields), str(path))


def parse_recipe(content: dict[Any, Any], where: str) -> Recipe:
    """Check the content of a recipe, which errors call `where`: an InputError tells the first field that is wrong."""
    return _validate(Recipe, content, where)


def parse_filter(text: str, where: str) -> Filter:
    """A filter written as a YAML mapping, such as `{category: [cyclists]}`; InputError where a field is wrong."""
    try:
        content = parse_yaml(text, where)
    except InputError as error:
        shown = f"{text!r:.{_SHOWN}}"
        raise InputError(f"{error}: {shown} is not YAML; write a mapping such as {{category: [cyclists]}}") from error
    return _validate(Filter, content, where)


def builtin_recipes() -> list[str]:
    """Names of the recipes that come with the package."""
    folder = files("olt_datasets") / "recipes"
    return sorted(Path(entry.name).stem for entry in folder.iterdir() if entry.name.endswith(RECIPE_SUFFIXES))


def find_recipe(path_or_name: str) -> Recipe:
    """The recipe in a YAML file, or the built-in one of this name.

    Raises:
        InputError: neither exists, or the recipe is wrong.
    """
    if path_or_name.endswith(RECIPE_SUFFIXES):
        return read_recipe(Path(path_or_name))
    name, known = path_or_name, builtin_recipes()
    if name not in known:
        raise InputError(f"no built-in recipe {name!r}; there are {', '.join(known)}, or give a YAML file")
    text = (files("olt_datasets") / "recipes" / f"{name}.yaml").read_text(encoding="utf-8")
    where = f"built-in recipe {name}"
    return parse_recipe(parse_yaml(text, where), where)


Model = TypeVar("Model", bound=BaseModel)


def _validate(model: type[Model], content: object, where: str) -> Model:
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{where}: {_explain(model, error)}") from error


def _explain(model: type[BaseModel], errors: ValidationError) -> str:
    """What is wrong with the first field that is, and what to do, in one line."""
    error = errors.errors(include_url=False)[0]
    location, value, message = error["loc"], error["input"], error["msg"]
    field = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).removeprefix(".")
    prefix = f"{field}: " if field else ""
    shown = f"{value!r:.{_SHOWN}}"
    match error["type"]:
        case "extra_forbidden":
            parents = location[:-1]
            holder = Filter if "where" in parents else Component if "components" in parents else model
            return f"unknown key {field!r:.{_SHOWN}}; known here: {', '.join(holder.model_fields)}"
        case "missing":
            return f"key {field!r} is missing; add it"
        case "value_error":
            return prefix + message.removeprefix("Value error, ")
        case "tuple_type":
            return f"{prefix}write a list, such as [{value!s:.{_SHOWN}}]"
        case "model_type":
            return f"{prefix}write a mapping, got {shown}"
        case "string_pattern_mismatch":
            return f"{prefix}holds a line break or another control character, got {shown}; remove it"
        case "string_type" if value is not None:
            shown += "; put it in quotes if it is a word"
        case "int_type" if isinstance(value, str) and _is_number(value):
            shown += f"; YAML takes {value:.{_SHOWN}} for text, write the number with all its digits"
    return f"{prefix}{message[0].lower()}{message[1:]}, got {shown}"


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
