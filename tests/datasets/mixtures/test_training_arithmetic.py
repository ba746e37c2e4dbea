from operator import itemgetter

import pytest

from olt_datasets.mixtures.training_arithmetic import PAPER_STAGES, TrainingStage, parse_stage, training_arithmetic
from olt_generator.errors import InputError


@pytest.mark.parametrize("samples", range(12_241, 12_249))
def test_arithmetic_of_the_paper(samples):
    first, second = (training_arithmetic(samples, stage) for stage in PAPER_STAGES)
    facts = itemgetter("samples_per_epoch", "steps_per_epoch", "total_steps")
    assert facts(first) == (12_256, 383, 1_149)
    assert facts(second) == (12_248, 1_531, 4_593)
    assert second["padded_samples"] == 12_248 - samples


@pytest.mark.parametrize("samples", [12_240, 12_249])
def test_no_other_number_of_samples_gives_the_paper_s_arithmetic(samples):
    assert training_arithmetic(samples, PAPER_STAGES[1])["steps_per_epoch"] != 1_531


def test_nothing_to_train_on_takes_no_steps():
    assert training_arithmetic(0, PAPER_STAGES[0]) == {
        "samples": 0,
        "global_batch": 32,
        "steps_per_epoch": 0,
        "total_steps": 0,
        "samples_per_epoch": 0,
        "padded_samples": 0,
    }


def test_a_stage_is_read_as_it_is_written():
    stage = parse_stage("16x2x4x3")
    assert stage == TrainingStage(devices=16, per_device_batch=2, accumulation=4, epochs=3)
    assert (str(stage), stage.global_batch) == ("16x2x4x3", 128)
    for text in ("8x1x4", "8x1x4x0", "8*1*4*3", "", "8x1x4x3x"):
        with pytest.raises(InputError, match="write DEVICESxBATCHxACCUMULATIONxEPOCHS"):
            parse_stage(text)
