"""`olt generate train` and `evaluate` on drives that the command makes itself, as small as they can be."""

import json

import cv2
import pytest
from typer.testing import CliRunner

from olt_toolkit.commands.generate import app

SMALL = """\
base: tiny
training:
  {width: 48, height: 32, frames: 5, windows: 2, seen: 0.25, unseen: 0.25,
   autoencoder: {steps: 2, save_every: 1}, optimizer: {steps: 2, batch: 2, save_every: 1}}
"""


def invoke(*arguments):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp("config") / "small.yaml"
    path.write_text(SMALL)
    return path


@pytest.fixture(scope="module")
def run(config, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    invoke("train", "--config", config, "--drives", 1, "--out", folder, "--workers", 1)
    return folder


def test_a_run_on_two_processes_and_taken_up_again_gives_the_same_bytes(run, config, tmp_path):
    command = ("train", "--config", config, "--drives", 1, "--out", tmp_path, "--workers", 2)
    invoke(*command)
    assert contents(tmp_path / "videos") == contents(run / "videos")
    made = contents(tmp_path / "engine")
    assert made == contents(run / "engine")
    first = sorted((tmp_path / "videos").iterdir())[0]
    stamp, kept = first.stat().st_mtime_ns, first.read_bytes()
    for path in (tmp_path / "engine", tmp_path / "cache"):
        for file in path.iterdir():
            file.unlink()
        path.rmdir()
    last = sorted((tmp_path / "videos").iterdir())[-1]
    last.unlink()
    invoke(*command)
    assert contents(tmp_path / "engine") == made
    assert (first.stat().st_mtime_ns, first.read_bytes()) == (stamp, kept)
    assert last.exists()


def test_an_engine_is_scored_beside_the_geometric_one(run, tmp_path):
    told = json.loads(invoke("evaluate", run, "--split", "unseen", "--steps", 1, "--json"))
    assert (told["split"], told["steps"], len(told["views"])) == ("unseen", 1, 5)
    assert told["n"] >= told["scenes"] >= 1
    for view in told["views"]:
        assert "geokpm" in view and view["lpips"] is None
        assert view["gain"] == pytest.approx(view["psnr"] - view["geometric_psnr"], abs=1e-6)
    picture = tmp_path / "sheet.png"
    table = invoke("evaluate", run, "--split", "seen", "--steps", 1, "--picture", picture)
    # Three columns of 288 pixels, and five views below each other.
    height, width = cv2.imread(str(picture)).shape[:2]
    assert width >= 3 * 288 and height >= 5 * 192
    assert "ssim" in table and "gain there" in table
