import math

import pytest

from olt_generator.errors import InputError
from olt_sft_recipes.training.stage_config import builtin_stage_config, read_stage_config


def write(tmp_path, text):
    path = tmp_path / "stage.yaml"
    path.write_text(text)
    return path


def test_builtin_stages_are_read():
    assert builtin_stage_config(1).stage == 1
    assert builtin_stage_config(2).stage == 2


def test_schedule_is_that_of_the_real_recipe():
    stage = builtin_stage_config(1).model_copy(update={"learning_rate": 1e-5, "min_lr": 1e-6, "warmup_steps": 500})
    assert stage.learning_rate_at(0, 1149) == pytest.approx(1e-5 / 500)
    assert stage.learning_rate_at(499, 1149) == pytest.approx(1e-5)
    assert stage.learning_rate_at(1148, 1149) == pytest.approx(1e-6)
    half = stage.learning_rate_at(499 + 325, 1149)
    assert half == pytest.approx(1e-6 + 9e-6 * 0.5 * (1 + math.cos(math.pi * 0.5 + math.pi * 0.5 / 325 * 0)), rel=1e-2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stage: 1\nlearning_rat: 1.0e-3\n", "unknown key learning_rat"),
        ("stage: 3\n", "stage"),
        ("stage: 1\nlearning_rate: -1\n", "learning_rate"),
        ("stage: 2\nhidden_token_probability: 0.5\n", "stage 1 only"),
        ("- 1\n- 2\n", "a mapping"),
        ("stage: [1\n", "not YAML"),
    ],
)
def test_bad_stage_files_are_told(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read_stage_config(write(tmp_path, text))


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(InputError, match="cannot read"):
        read_stage_config(tmp_path / "absent.yaml")
