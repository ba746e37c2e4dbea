"""Options that a source or a command cannot honour are refused by name."""

import numpy as np
import pytest
from typer.testing import CliRunner

from olt_datasets.commands.data import app as data_app
from olt_datasets.commands.mix import app as mix_app
from olt_generator.errors import InputError
from olt_generator.video import write_video
from olt_toolkit import OpenOptions
from olt_toolkit.commands.clip import app as clip_app
from olt_toolkit.recordings.drives import open_dataset

GIVEN = {
    "--fov": OpenOptions(horizontal_fov=1.2),
    "--camera-height": OpenOptions(camera_height=1.5),
    "--rotate": OpenOptions(rotate=180),
    "--mirror": OpenOptions(mirror=True),
}


def run(app, *arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=True)


@pytest.fixture
def video(tmp_path):
    write_video(tmp_path / "dash.mp4", np.full((5, 36, 64, 3), 90, np.uint8), 10)
    return tmp_path / "dash.mp4"


@pytest.fixture
def synthetic(tmp_path):
    folder = tmp_path / "synthetic"
    folder.mkdir()
    (folder / "synthetic.yaml").write_text("categories: [nominal]\ncount: 1\nseed: 0\n")
    return folder


@pytest.mark.parametrize(("name", "options"), GIVEN.items())
def test_what_is_said_of_a_calibrated_camera_is_refused(synthetic, name, options):
    dataset = open_dataset(synthetic)
    with pytest.raises(InputError, match=f"{name}: .*calibrated camera"):
        dataset.open(dataset.keys()[0], (0, 100_000), options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seed", 3], "--seed: nothing is disturbed without --jitter-m"),
        (["--jitter-deg", 0.1], "--jitter-deg: nothing is disturbed"),
        (["--stride", 3], "--stride: the recording is one clip"),
        (["--rotate", 45], "--rotate 45: give 0, 90, 180 or 270"),
        (["--camera-height", -1], "--camera-height -1"),
    ],
)
def test_a_trajectory_refuses_what_it_does_not_use(video, arguments, message):
    assert message in str(run(clip_app, "trajectory", video, *arguments).exception)


def test_a_build_without_learned_models_takes_no_device(video, tmp_path):
    result = run(clip_app, "build", video, "--out", tmp_path / "clips", "--device", "cuda")
    assert "--device cuda: no learned model is run" in str(result.exception)


@pytest.mark.parametrize(
    ("rule", "arguments", "message"),
    [
        ("seen", ["--seed", 3], "--seed: only rule unseen"),
        ("unseen", ["--gap", 1], "--gap: only rule seen"),
        ("own", ["--test", 0.5], "--test: rule own leaves no share"),
    ],
)
def test_a_split_refuses_what_its_rule_does_not_use(tmp_path, rule, arguments, message):
    table = tmp_path / "clips.parquet"
    assert message in str(run(data_app, "split", table, "--rule", rule, "--out", table, *arguments).exception)


@pytest.mark.parametrize("arguments", [["--example", "--by", "country"], ["--example", "clips.parquet"]])
def test_the_papers_example_takes_no_tables(arguments):
    assert "--example shows the paper's counts" in str(run(mix_app, "align", *arguments).exception)


def test_an_index_by_seconds_takes_no_frames(video):
    result = run(data_app, "index", video.parent, "--out", "t.parquet", "--seconds", 2, "--frames", 10)
    assert "--frames: windows are cut by --seconds" in str(result.exception)


def test_an_index_tells_what_it_passed_over(video, tmp_path):
    (video.parent / "._dash.mp4").write_bytes(b"\x00\x05\x16\x07" + bytes(100))
    out = tmp_path / "t.parquet"
    result = run(data_app, "index", video.parent, "--out", out, "--cache", tmp_path / "cache", "--workers", 1)
    assert result.exit_code == 0, result.output
    assert "left out: 1 of 2 files called videos: hidden files" in result.output.replace("\n", " ")
