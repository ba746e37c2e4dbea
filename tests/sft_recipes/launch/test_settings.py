"""Overrides, held against Hydra itself on a tree of configurations that the tests write."""

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given
from hypothesis import strategies as st

from olt_generator.errors import InputError
from olt_sft_recipes.launch.log_watch import UNIFORM_LOSS, Expected, LogWatch
from olt_sft_recipes.launch.pai_data import PaiData
from olt_sft_recipes.launch.plan import Places, make_plan
from olt_sft_recipes.launch.public_recipes import PUBLIC_RECIPES
from olt_sft_recipes.launch.stage_settings import (
    builtin_stage_settings,
    find_differences,
    read_stage_settings,
    to_hydra,
)
from olt_sft_recipes.launch.torchrun import Machines
from olt_sft_recipes.preflight.parameters import published_sizes


def compose_stage(recipes, package, arguments):
    """The configuration that Hydra makes of the arguments of a stage."""
    name = arguments[arguments.index("--config-name") + 1]
    overrides = list(arguments[arguments.index(name) + 1 :])
    configs = recipes / "recipes" / package / "configs"
    with initialize_config_dir(version_base=None, config_dir=str(configs)):
        return compose(name, overrides=overrides)


def plan_of(policy, recipes, tmp_path, lora=False, base_config=None, stage1_file=None):
    recipe = PUBLIC_RECIPES[policy]
    places = Places(tmp_path / "the run, a=b", recipes, tmp_path / "it's a base", tmp_path / "bin" / "python")
    data = PaiData(tmp_path / "pai {1}", "0-7", 12_245, True)
    first = builtin_stage_settings(policy, 1) if stage1_file is None else read_stage_settings(stage1_file, 1)
    stages = ((1, first), (2, builtin_stage_settings(policy, 2)))
    return make_plan(recipe, places, Machines(), data, None, stages, published_sizes(), base_config, lora=lora)


@pytest.mark.filterwarnings("ignore:.*Defaults list is missing.*")
@pytest.mark.parametrize("policy", PUBLIC_RECIPES)
def test_every_override_is_one_for_hydra_and_says_what_the_paper_says(policy, recipes, tmp_path):
    plan = plan_of(policy, recipes, tmp_path)
    first, second = (compose_stage(recipes, plan.recipe.package, each.arguments) for each in plan.stages)
    for config in (first, second):
        assert config.trainer.num_train_epochs == 3 and config.trainer.bf16 is True
        assert config.trainer.per_device_train_batch_size == 1
        assert config.trainer.lr_scheduler_type == "cosine_warmup_with_min_lr"
        assert config.trainer.lr_scheduler_kwargs.min_lr == 1e-6
        assert config.data.train_dataset.chunk_ids == "0-7" and config.data.train_dataset.use_default_keyframe is False
        assert config.data.train_dataset.local_dir == str(tmp_path / "pai {1}") == config.data.val_dataset.local_dir
    assert (first.trainer.gradient_accumulation_steps, second.trainer.gradient_accumulation_steps) == (4, 1)
    assert (first.trainer.learning_rate, second.trainer.learning_rate) == (1e-5, 1e-4)
    assert (first.trainer.warmup_steps, second.trainer.warmup_steps) == (500, 100)
    assert (first.trainer.gradient_checkpointing, second.trainer.gradient_checkpointing) == (True, False)
    assert dict(first.trainer.lr_multiplier) == {"vlm.model.visual": 0.1}
    assert first.trainer.deepspeed == str(recipes / "recipes" / plan.recipe.package / "configs/deepspeed/zero2.json")
    assert second.trainer.deepspeed is None and second.trainer.ddp_find_unused_parameters is True
    assert second.model.cotrain_vlm is False
    assert second.model.stage1_vlm_checkpoint_path == str(tmp_path / "the run, a=b" / "stage1" / "checkpoint-1149")
    assert [each.arithmetic["total_steps"] for each in plan.stages] == [1149, 4593]


@pytest.mark.filterwarnings("ignore:.*Defaults list is missing.*")
@pytest.mark.parametrize(("told", "shown"), [({}, True), ({"include_camera_ids": False}, False)])
def test_1_5_is_shown_the_names_of_cameras_as_its_base_says(recipes, tmp_path, told, shown):
    plan = plan_of("alpamayo-1.5", recipes, tmp_path, base_config=told)
    config = compose_stage(recipes, "alpamayo1_5_sft", plan.stages[0].arguments)
    assert config.data.train_dataset.vla_preprocess_args.include_camera_ids is shown
    assert config.data.val_dataset.vla_preprocess_args.include_frame_nums is True


@pytest.mark.filterwarnings("ignore:.*Defaults list is missing.*")
@pytest.mark.parametrize("policy", PUBLIC_RECIPES)
def test_adapters_freeze_the_rest_where_the_recipe_has_them(policy, with_lora, tmp_path):
    plan = plan_of(policy, with_lora, tmp_path, lora=True)
    config = compose_stage(with_lora, plan.recipe.package, plan.stages[0].arguments)
    assert config.lora.freeze_non_adapted is True and config.trainer.lr_multiplier is None
    assert sum(module.trained for module in plan.stages[0].modules) == 43_646_976
    assert "lora" not in compose_stage(with_lora, plan.recipe.package, plan.stages[1].arguments)


@pytest.mark.filterwarnings("ignore:.*Defaults list is missing.*")
def test_adapters_leave_what_a_file_says(with_lora, stage1_file, tmp_path):
    given = stage1_file(learning_rate=3e-5, lr_multiplier={"vlm.model.visual": 0.5})
    plan = plan_of("alpamayo-r1", with_lora, tmp_path, lora=True, stage1_file=given)
    config = compose_stage(with_lora, plan.recipe.package, plan.stages[0].arguments)
    assert config.trainer.learning_rate == 3e-5 and config.trainer.lr_multiplier == {"vlm.model.visual": 0.5}
    assert config.lora.freeze_non_adapted is True


def test_keys_that_the_recipe_has_and_the_table_has_not_reach_hydra(recipes, stage1_file, tmp_path):
    given = stage1_file({"max_eval_steps": 10}, gradient_checkpointing_kwargs={"use_reentrant": True}, weight_decay=0.1)
    plan = plan_of("alpamayo-r1", recipes, tmp_path, stage1_file=given)
    config = compose_stage(recipes, plan.recipe.package, plan.stages[0].arguments)
    assert config.trainer.gradient_checkpointing_kwargs.use_reentrant is True and config.trainer.weight_decay == 0.1
    assert config.evaluate.max_eval_steps == 10


def reasons_of(plan):
    return {each.key.removeprefix("trainer."): each.reason for each in plan.stages[0].differences}


def test_a_reason_stands_only_beside_the_value_that_it_is_of(with_lora, stage1_file, tmp_path):
    of_file = reasons_of(
        plan_of("alpamayo-r1", with_lora, tmp_path, stage1_file=stage1_file(gradient_accumulation_steps=1))
    )
    assert of_file["gradient_accumulation_steps"] == "set in the file that was given"
    assert "so that the log says" in of_file["log_level"] and "absolute path" in of_file["deepspeed"]
    of_adapters = reasons_of(plan_of("alpamayo-r1", with_lora, tmp_path, lora=True))
    assert "ten times" in of_adapters["learning_rate"] and "image encoder" in of_adapters["lr_multiplier"]
    assert "adapters" in of_adapters["lora.r"]


def test_adapters_are_refused_where_the_recipe_has_none(recipes, tmp_path):
    with pytest.raises(InputError, match="this recipe has no adapters"):
        plan_of("alpamayo-r1", recipes, tmp_path, lora=True)


@given(st.text(alphabet=st.sampled_from("ab01 .:/\\'\"=,{}[]()~+-_@%#é*?!&|<>;`"), min_size=1, max_size=12))
def test_any_text_reaches_hydra_as_it_is(text):
    value = OverridesParser.create().parse_override(f"a.b={to_hydra(text)}").value()
    assert type(value) is str and value == text


@pytest.mark.parametrize("text", ["a${b}", "a\nb"])
def test_a_text_that_hydra_would_change_is_refused(text):
    with pytest.raises(InputError, match="choose a name"):
        to_hydra(text)


@pytest.mark.parametrize("policy", PUBLIC_RECIPES)
def test_every_difference_from_the_shipped_recipe_has_a_reason(policy, recipes, tmp_path):
    for each in plan_of(policy, recipes, tmp_path).stages:
        assert each.differences and all(
            "file that was given" not in difference.reason for difference in each.differences
        )
    assert [
        each.key for each in find_differences("alpamayo-r1", 1, builtin_stage_settings("alpamayo-r1", 1).values)
    ] == ["trainer.log_level"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("trainer: {num_train_epochs: 3}\n", "defaults"),
        ("defaults: [sft_stage1, _self_]\ntrainer: {learning_rate: 0.1}\n", "per_device_train_batch_size"),
        ("defaults: [sft_stage1, _self_]\npaths: {output_dir: x}\n", "a launch sets this itself"),
        ("defaults: [sft_stage1, 3, _self_]\n", "GROUP@PLACE"),
        ("defaults: [sft_stage2, _self_]\n", "--stage2"),
        ("defaults: [sft_base, models@model: ar1_5_expert, _self_]\nmodel: {cotrain_vlm: false}\n", "--stage2"),
        *(
            (f"defaults: [sft_stage1, _self_]\ntrainer: {{{key}: {value}}}\n", f"trainer.{key}: a launch sets this")
            for key, value in (
                ("deepspeed", "configs/deepspeed/zero3.json"),
                ("max_steps", 100),
                ("dataloader_drop_last", "true"),
                ("save_strategy", "'no'"),
                ("output_dir", "x"),
                ("log_level", "warning"),
            )
        ),
    ],
)
def test_a_stage_file_that_cannot_be_launched_is_refused(tmp_path, content, said):
    path = tmp_path / "stage.yaml"
    path.write_text(content)
    with pytest.raises(InputError, match=said):
        read_stage_settings(path, 1)


def test_a_log_of_a_healthy_training_passes_and_tells_how_far_it_is():
    watch = LogWatch(Expected(1, "/pai", range(0, 2), 12_245, 1149, 100))
    for line in (
        "Loading from /pai with chunk_ids: [0, 1]",
        "Loading from /elsewhere with chunk_ids: [7]",
        "  Num examples = 12,245",
        "  Total optimization steps = 1,149",
        "  Number of trainable parameters = 100",
        "{'loss': 1.668, 'grad_norm': 0.9368, 'learning_rate': 1.25e-08, 'epoch': 0.02}",
        " 10%|#         | 115/1149 [00:10<01:00,  9.9it/s]",
        "  3%|#         | 7/226 [00:10<01:00,  9.9it/s]",
    ):
        watch.see(line)
    assert watch.step == 115 and watch.losses == [(0.02, 1.668)]
    assert 8.0 < UNIFORM_LOSS < 8.01


@pytest.mark.parametrize(
    ("line", "losses"),
    [
        ("{'loss': 1.6, 'grad_norm': 0.9, 'epoch': 0.1}{'loss': 1.5, 'epoch': 0.2}", [(0.1, 1.6), (0.2, 1.5)]),
        ("{'loss': 1.6, 'epoch': 0.1} 40%|#  | 5/12 [00:01<00:01,  5.0it/s] {x}", [(0.1, 1.6)]),
        ("{'loss': np.float64(1.6), 'grad_norm': None, 'learning_rate': 1e-08, 'epoch': 0.1}", [(0.1, 1.6)]),
        ("{'loss': 1.6[INFO] saving, 'grad_norm': 0.9, 'epoch': 0.1}", []),
        ("{'loss': 1.61.5, 'grad_norm': 0.9, 'epoch': 0.1}", []),
        ("{'loss': 1.6, 'grad_nor{'loss': 1.5, 'epoch': 0.2}", [(0.2, 1.5)]),
        ("Loading from /pai with chunk_ids: [0, 1][INFO] [x]", []),
    ],
)
def test_lines_of_processes_that_write_into_each_other_are_read_as_far_as_they_can_be(line, losses):
    watch = LogWatch(Expected(1, "/pai", range(0, 2), 12_245, 12, 100))
    watch.see(line)
    assert watch.losses == losses and watch.step == (5 if "5/12" in line else 0)


@pytest.mark.parametrize(
    "line",
    [
        "Loading from /pai with chunk_ids: []",
        "Invalid chunk_ids: 3 <class 'float'>",
        "Num examples = 12,244",
        "Total optimization steps = 1,150",
        "Number of trainable parameters = 8,797,933,808",
        "{'loss': 8.1, 'epoch': 0.02}",
        "{'loss': 1.0, 'grad_norm': inf, 'epoch': 0.02}",
        "{'loss': nan, 'epoch': 0.02}",
        "{'loss': NaN, 'epoch': 0.02}",
        "{'loss': 1.0, 'grad_norm': np.float64(inf), 'epoch': 0.02}",
        "{'loss': 1.0[INFO] saving, 'grad_norm': nan, 'epoch': 0.02}",
        "{'loss': 1.0, 'epoch': 0.02}{'loss': -inf, 'epoch': 0.04}",
    ],
)
def test_a_line_that_shows_a_silent_failure_is_refused(line):
    with pytest.raises(InputError):
        LogWatch(Expected(1, "/pai", range(0, 2), 12_245, 1149, 100)).see(line)
