import json
from dataclasses import replace

import pytest

from olt_generator.errors import InputError
from olt_generator.video import write_video
from olt_sft_recipes.demo.main_job import run_demo
from olt_sft_recipes.demo.scenes import ROLES, plan_scenes
from olt_sft_recipes.demo.settings import DemoSettings
from olt_sft_recipes.demo.stage_log import StageLog
from olt_sft_recipes.demo.summary import list_left_out
from olt_toolkit.rigs.rig import FRONT_WIDE

SMALL = DemoSettings(
    nominal_clips=1,
    long_tail_clips=1,
    validation_clips=1,
    rollouts=1,
    input_size=(144, 256),
    training_front_size=(144, 256),
    training_size=(64, 112),
)


def test_no_scene_has_two_roles():
    names = [scene for role in ROLES for scene in plan_scenes(DemoSettings())[role]]
    assert len(names) == len(set(names))
    other = [scene for role in ROLES for scene in plan_scenes(DemoSettings(seed=1))[role]]
    assert not set(names) & set(other)


def test_a_finished_stage_is_not_run_again(tmp_path):
    calls = []
    log = StageLog(tmp_path, {"seed": 1})
    for _ in range(2):
        assert log.run("one", lambda: calls.append(1) or {"answer": (1, 2)}) == {"answer": [1, 2]}
    assert len(calls) == 1
    assert StageLog(tmp_path, {"seed": 1}).run("one", lambda: {"answer": None}) == {"answer": [1, 2]}


def test_a_failed_stage_is_run_again(tmp_path):
    log = StageLog(tmp_path, {})
    with pytest.raises(ZeroDivisionError):
        log.run("one", lambda: {"answer": 1 / 0})
    assert log.run("one", lambda: {"answer": 1}) == {"answer": 1}


def test_another_job_in_the_same_folder_is_refused(tmp_path):
    StageLog(tmp_path / "stages", {"seed": 1})
    with pytest.raises(InputError, match="choose another --out"):
        StageLog(tmp_path / "stages", {"seed": 2})


def test_an_unusable_video_leaves_no_folder(tmp_path):
    video = tmp_path / "notes.mp4"
    video.write_text("not a video")
    with pytest.raises(InputError, match=r"notes\.mp4"):
        run_demo(tmp_path / "out", SMALL, video)
    assert not (tmp_path / "out").exists()


def test_what_was_left_out_is_told_with_its_reason():
    clip = {"left_out": [{"what": "camera_rear", "why": "not wanted"}], "clip": {"no_sample_reason": "too short"}}
    policies = {"toy": {"left_out": ["rendering"], "scores": [{"left_out": ["tests"]}, {"left_out": ["tests"]}]}}
    clips = {"input": clip, "training": {"frames_left_out_of_each_view": 7}}
    results = {"clips": clips, "closed_loop": {"policies": policies}}
    assert list_left_out(results) == [
        "camera_rear: not wanted",
        "policy samples of the input clip: too short",
        "7 frames of each view of the training clips: no sample of these clips shows them",
        "rendering",
        "tests",
    ]


def comparable(summary):
    return json.dumps({key: value for key, value in summary.items() if key not in ("timings", "machine")})


@pytest.mark.slow
def test_the_main_job_runs_resumes_and_does_not_depend_on_the_number_of_workers(tmp_path):
    summary = run_demo(tmp_path / "one", SMALL, workers=1)
    assert (tmp_path / "one" / "report.html").stat().st_size > 10_000
    assert comparable(json.loads((tmp_path / "one" / "summary.json").read_text())) == comparable(summary)
    assert summary["input"]["pose_errors"]["metric"]["ate_m"] < 5.0
    assert summary["input"]["clip"]["views"][FRONT_WIDE]["kind"] == "rendered"
    (tmp_path / "one" / "stages" / "closed_loop.json").unlink()
    assert comparable(run_demo(tmp_path / "one", SMALL, workers=1)) == comparable(summary)
    assert comparable(run_demo(tmp_path / "two", SMALL, workers=2)) == comparable(summary)


@pytest.mark.slow
def test_a_five_frame_video_runs_to_the_end(tmp_path, make_textured_drive):
    video = tmp_path / "five.mp4"
    write_video(video, make_textured_drive(5), 25.0)
    summary = run_demo(tmp_path / "out", replace(SMALL, long_tail_clips=1), video, workers=2)
    assert summary["input"]["clip"]["no_sample_reason"]
    assert summary["input"]["clip"]["views"][FRONT_WIDE]["kind"] == "observed"
    assert any("policy samples of the input clip" in line for line in summary["left_out"])
