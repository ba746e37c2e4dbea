"""Configurations of training by name and file, and tables of an evaluation."""

import pytest

from olt_generator.diffusion.config import CONFIGS
from olt_generator.diffusion.training_settings import TRAININGS
from olt_generator.errors import InputError
from olt_toolkit.commands.generate_evaluate import EvaluationSplit, summarise
from olt_toolkit.commands.generate_train import read_training


def test_a_name_is_its_configuration():
    assert read_training("tiny") == (CONFIGS["tiny"], TRAININGS["tiny"])
    assert read_training("1.3B")[1].optimizer.warmup == 500
    with pytest.raises(InputError, match="no such engine"):
        read_training("huge")


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path):
    path = tmp_path / "changed.yaml"
    path.write_text(
        "base: tiny\nengine: {conditioning: {plucker: false}}\ntraining: {flow: {use_warp: false}, frames: 13}\n"
    )
    engine, training = read_training(str(path))
    assert not engine.conditioning.plucker and engine.backbone == CONFIGS["tiny"].backbone
    assert not training.flow.use_warp and training.frames == 13
    assert training.optimizer == TRAININGS["tiny"].optimizer


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("base: huge", "give base"),
        ("base: tiny\nother: 1", "give base"),
        ("base: tiny\ntraining: {speed: 3}", "speed"),
        ("base: tiny\ntraining: {frames: many}", "frames"),
        ("base: tiny\ntraining: {optimizer: {steps: 0}}", "steps: 0"),
        ("base: tiny\nengine: 3", "give a mapping"),
    ],
)
def test_odd_files_are_refused(tmp_path, content, said):
    path = tmp_path / "odd.yaml"
    path.write_text(content)
    with pytest.raises(InputError, match=said):
        read_training(str(path))


def test_what_was_not_measured_is_not_measured_in_the_mean():
    rows = [
        {"view": "a", "scene": "s", "psnr": 10.0, "geokpm": None, "invented_psnr": None},
        {"view": "a", "scene": "s", "psnr": 20.0, "geokpm": 50.0, "invented_psnr": None},
    ]
    table = summarise(rows, EvaluationSplit.UNSEEN, 2)
    assert (table["n"], table["scenes"]) == (2, 1)
    (view,) = table["views"]
    assert (view["psnr"], view["geokpm"], view["invented_psnr"], view["lpips"]) == (15.0, 50.0, None, None)
    (seen,) = summarise(rows, EvaluationSplit.SEEN, 2)["views"]
    assert seen["ssim"] is None


def test_gains_over_the_geometric_engine_are_told_with_intervals_over_scenes():
    rows = [
        {"view": "a", "scene": scene, "psnr": 20.0, "geometric_psnr": 20.0 - gain, "invented_psnr": invented}
        | {"geometric_invented_psnr": 10.0}
        for scene, gain, invented in (("s", 1.0, 12.0), ("s", 3.0, None), ("t", 4.0, None), ("u", 6.0, None))
    ]
    (view,) = summarise(rows, EvaluationSplit.UNSEEN, 4)["views"]
    # Scenes gain 2, 4 and 6 dB: the mean is 4, its standard error 2 / sqrt(3), and t for two degrees 4.3027.
    assert view["gain"] == pytest.approx(4.0)
    assert view["gain_interval"] == pytest.approx((4.0 - 4.9683, 4.0 + 4.9683), abs=1e-3)
    assert (view["invented_gain"], view["invented_gain_interval"]) == (pytest.approx(2.0), None)
