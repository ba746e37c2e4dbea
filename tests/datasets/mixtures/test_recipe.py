import re
import textwrap
from fractions import Fraction

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import olt_datasets.mixtures.recipe as recipe_module
from olt_datasets.mixtures.recipe import (
    Filter,
    builtin_recipes,
    find_recipe,
    parse_filter,
    parse_recipe,
    read_recipe,
)
from olt_generator.errors import InputError

RECIPE = """
name: mine
description: nominal and work zones
version: 1
samples: 100
held_out_scenes: [scene_1]
components:
  - name: nominal
    where: {kind: GT, category: [nominal]}
    share: 0.7
  - name: work_zones
    where: {source: [pai], factors_any: [work_zone, cones], factors_none: [night]}
    share: 0.3
    repeats: 2
    prefer: GT
"""


def write(tmp_path, text):
    path = tmp_path / "recipe.yaml"
    path.write_text(text)
    return path


def test_a_recipe_is_read_as_written(tmp_path):
    recipe = find_recipe(str(write(tmp_path, RECIPE)))
    nominal, work_zones = recipe.components
    assert (recipe.name, recipe.split, recipe.samples, recipe.held_out_scenes) == ("mine", "train", 100, ("scene_1",))
    assert nominal.where == Filter(kind="GT", category=("nominal",))
    assert (work_zones.share, work_zones.repeats, work_zones.prefer) == (0.3, 2, "GT")
    assert str(work_zones.where) == "{source: [pai], factors_any: [work_zone, cones], factors_none: [night]}"


def test_built_in_recipes_are_sound_and_named_as_their_files():
    assert {"toy_nominal", "toy_nominal_long_tail"} <= set(builtin_recipes())
    for name in builtin_recipes():
        assert find_recipe(name).name == name
    with pytest.raises(InputError, match="no built-in recipe 'toy'; there are base_1_5, "):
        find_recipe("toy")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("samples: 100", "sample: 100", "unknown key 'sample'; known here: name, description, version, split, samples"),
        ("kind: GT", "kinds: GT", "unknown key 'components[0].where.kinds'; known here: kind, source, country"),
        ("repeats: 2", "repeat: 2", "unknown key 'components[1].repeat'; known here: name, where, share, share_by"),
        ("version: 1", "", "key 'version' is missing"),
        ("version: 1", "version: 2", "version 2 of the recipe format is not known; this release reads 1"),
        ("version: 1", "version: '1'", "version: input should be a valid integer, got '1'"),
        ("kind: GT", "kind: gt", "components[0].where.kind: input should be 'GT', 'Syn' or 'any', got 'gt'"),
        ("[nominal]", "nominal", "components[0].where.category: write a list, such as [nominal]"),
        ("{kind: GT, category: [nominal]}", "all", "components[0].where: write a mapping, got 'all'"),
        ("share: 0.3", "share: 0.2", "the shares sum to 0.9; change them to sum to 1"),
        ("share: 0.3", "count: 3", "some components give 'share' and some 'count'"),
        ("share: 0.3", "", "components[1]: give exactly one of 'share', 'share_by_epoch' and 'count'"),
        (
            "share: 0.7",
            "share: 0.7\n    count: 3",
            "components[0]: give exactly one of 'share', 'share_by_epoch' and 'count'",
        ),
        ("share: 0.7", "share: .nan", "components[0].share: input should be"),
        ("share: 0.7", "share: -0.7", "components[0].share: input should be greater than 0"),
        ("repeats: 2", "repeats: true", "components[1].repeats: input should be a valid integer, got True"),
        ("name: work_zones", "name: nominal", "two components are called 'nominal'"),
        ("{source: [pai],", "{kind: Syn,", "components[1]: 'prefer' chooses between kinds"),
        ("repeats: 2", "t0: keyframe\n    samples_per_clip: 2", "components[1]: 't0: keyframe' is one sample per clip"),
        ("repeats: 2", "t0: events", "components[1].t0: input should be 'every' or 'keyframe', got 'events'"),
        ("repeats: 2", "caps: {cyclists: 0}", "components[1].caps.cyclists: input should be greater than 0, got 0"),
        ("share: 0.3", "share_by_epoch: {1: 0.3}", "components[1]: 'share_by_epoch' does not say the share of epoch 0"),
        ("share: 0.3", "share_by_epoch: {0: 0.0}", "components[1]: 'share_by_epoch' is 0 in every epoch"),
        ("share: 0.3", "share_by_epoch: {0: 0.3, 2: 0.4}", "the shares sum to 1.1 in epoch 2; change them"),
        ("share: 0.3", "share_by_epoch: {0: 1.3}", "components[1].share_by_epoch[0]: input should be less than"),
        ("name: mine", "name: [mine", "not YAML"),
        ("name: mine", "1: 2\nname: mine", "[1]: keys should be strings"),
        ("samples: 100", "samples: 100\nsamples: 200", "line 6: key 'samples' is there twice"),
        ("[nominal]", "[nominal]\ncomponents: []", "not YAML"),
        ("[nominal]", "[nominal], country: [NO]", "line 9: YAML takes NO for false; write 'NO', in quotes, or false"),
        ("[nominal]", "[true]", "components[0].where.category[0]: input should be a valid string, got True; put it in"),
        ("samples: 100", "samples: 1000000000000", "samples: input should be less than or equal to 100000000, got 10"),
        (
            "samples: 100",
            "samples: 1e6",
            "samples: input should be a valid integer, got '1e6'; YAML takes 1e6 for text",
        ),
        ("repeats: 2", "repeats: 1000000000000000000", "components[1].repeats: input should be less than or equal to"),
        ("repeats: 2", f"repeats: {'9' * 30}", "line 14: 999999999999999999999999999999 is beyond 9223372036854775807"),
        ("repeats: 2", "samples_per_clip: 1000000000", "components[1].samples_per_clip: input should be less than"),
        ("share: 0.3", "share_by_epoch: {0: 0.3, 1000000000: 0.1}", "components[1].share_by_epoch[1000000000]"),
        ("share: 0.3", "share: .inf", "components[1].share: input should be less than or equal to 1"),
        ("name: mine", 'name: "mi\\nne"', "name: holds a line break or another control character, got 'mi\\nne'"),
        ("name: mine", 'name: "mi\\0ne"', "line 2: the text 'mi\\x00ne' holds the control character"),
        ("name: mine", f"name: {'m' * 300}", "name: string should have at most 200 characters, got 'mmm"),
        ("kind: GT", f"kind: {'G' * 3000}", "components[0].where.kind: input should be 'GT', 'Syn' or 'any', got 'GGG"),
    ],
)
def test_errors_name_file_field_and_remedy(tmp_path, old, new, message):
    path = write(tmp_path, RECIPE.replace(old, new, 1))
    with pytest.raises(InputError, match=re.escape(f"{path}: {message}")) as error:
        read_recipe(path)
    assert "\n" not in str(error.value)


def test_shares_between_named_epochs():
    content = yaml.safe_load(RECIPE.replace("share: 0.7", "share_by_epoch: {0: 0.7, 3: 0.1}"))
    content["components"][1] |= {"share": None, "share_by_epoch": {0: 0.3, 3: 0.9}}
    linear, steps = (parse_recipe(content | {"between_epochs": word}, "recipe") for word in ("linear", "steps"))
    assert linear.named_epochs == [0, 3]
    assert [linear.shares(epoch)[1] for epoch in range(5)] == [Fraction(part, 10) for part in (3, 5, 7, 9, 9)]
    assert [steps.shares(epoch)[1] for epoch in range(5)] == [Fraction(part, 10) for part in (3, 3, 3, 9, 9)]


def test_the_example_of_the_documentation_is_a_recipe():
    text = textwrap.dedent(recipe_module.__doc__.split("curriculum.\n")[1])
    parsed = parse_recipe(yaml.safe_load(text), "example")
    assert parsed.components[1].caps == {"cyclists": 500} and parsed.components[1].where.country == ("US", "DE")


def test_a_filter_is_read_from_text():
    assert parse_filter("{category: [cyclists], country: [US]}", "--target") == Filter(
        category=("cyclists",), country=("US",)
    )
    for text, message in [
        ("{categories: [a]}", "unknown key 'categories'; known here: kind, source, country"),
        ("[a", "is not YAML"),
        ("all", "write a mapping, got 'all'"),
    ]:
        with pytest.raises(InputError, match=f"--target: .*{message}"):
            parse_filter(text, "--target")


def test_counts_decide_the_number_of_samples(tmp_path):
    counted = RECIPE.replace("share: 0.7", "count: 7").replace("share: 0.3", "count: 3")
    with pytest.raises(InputError, match="'samples' follows from the counts of the components; remove it"):
        read_recipe(write(tmp_path, counted))
    assert read_recipe(write(tmp_path, counted.replace("samples: 100", ""))).components[1].count == 3


def test_files_that_hold_no_recipe_are_refused(tmp_path):
    with pytest.raises(InputError, match="cannot read this recipe"):
        read_recipe(tmp_path / "absent.yaml")
    for text in ("", "- a list", "just text"):
        with pytest.raises(InputError, match="a recipe is a mapping with the keys name, description"):
            read_recipe(write(tmp_path, text))
    for text in ("name: !!python/object/apply:os.getcwd []", "name: 2026-13-45"):
        with pytest.raises(InputError, match="not YAML"):
            read_recipe(write(tmp_path, text))


plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@given(key=st.sampled_from(["name", "version", "split", "samples", "components", "held_out_scenes"]), value=plain)
def test_any_value_is_read_or_refused_in_one_line(key, value):
    content = yaml.safe_load(RECIPE) | {key: value}
    try:
        parse_recipe(content, "recipe")
    except InputError as error:
        assert str(error).startswith("recipe: ")


def test_a_recipe_of_very_many_components_is_refused():
    component = {"name": "a", "share": 1.0}
    content = yaml.safe_load(RECIPE) | {"components": [component | {"name": str(number)} for number in range(1000)]}
    with pytest.raises(InputError, match="components: tuple should have at most 256 items"):
        parse_recipe(content, "given")
