import math

import pytest
from typer.testing import CliRunner

from olt_generator.errors import InputError
from olt_sft_recipes.commands.demo import app
from olt_sft_recipes.demo import main_job


def test_what_is_known_of_the_camera_reaches_the_video(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(main_job, "run_demo", lambda out, settings, video, workers: seen.append(settings) or {})
    arguments = ["--video", str(tmp_path / "drive.mp4"), "--fov", "90", "--camera-height", "1.4", "--json"]
    assert CliRunner().invoke(app, arguments, catch_exceptions=False).exit_code == 0
    assert seen[0].video_fov == pytest.approx(math.pi / 2) and seen[0].video_camera_height == 1.4


def test_what_is_known_of_a_camera_without_its_video_is_refused(tmp_path):
    result = CliRunner().invoke(app, ["--out", str(tmp_path / "run"), "--fov", "90"])
    assert isinstance(result.exception, InputError) and "--video" in str(result.exception)
    assert not (tmp_path / "run").exists()
