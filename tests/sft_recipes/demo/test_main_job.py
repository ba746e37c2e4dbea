import json
import re
from dataclasses import replace

import pytest

from olt_closed_loop.evaluation.comparison import FEWEST_SCENES
from olt_generator.errors import InputError
from olt_generator.omissions import Omission, word_omission
from olt_generator.video import write_video
from olt_sft_recipes.demo.job_log import JobLog
from olt_sft_recipes.demo.main_job import DemoSettings, list_left_out, plan_scenes, run_demo
from olt_sft_recipes.demo.report import RECIPES, word_verdict
from olt_toolkit.rigs.rig import FRONT_WIDE

SMALL = DemoSettings(
    nominal_clips=1,
    long_tail_clips=1,
    validation_clips=1,
    evaluation_scenes=1,
    rollouts=1,
    input_size=(144, 256),
    training_front_size=(144, 256),
    training_size=(64, 112),
)


def test_no_scene_has_two_roles():
    names = [scene for role in plan_scenes(DemoSettings()).values() for scene in role]
    assert len(names) == len(set(names))
    other = [scene for role in plan_scenes(DemoSettings(seed=1)).values() for scene in role]
    assert not set(names) & set(other)


def open_log(folder, **job):
    return JobLog(folder, job, lambda step, share: None)


def test_a_finished_step_is_not_run_again(tmp_path):
    calls = []
    log = open_log(tmp_path, seed=1)
    for _ in range(2):
        assert log.run("one", lambda share: calls.append(1) or {"answer": (1, 2)}) == {"answer": [1, 2]}
    assert len(calls) == 1
    assert open_log(tmp_path, seed=1).run("one", lambda share: {"answer": None}) == {"answer": [1, 2]}


def test_a_failed_step_is_run_again(tmp_path):
    log = open_log(tmp_path)
    with pytest.raises(ZeroDivisionError):
        log.run("one", lambda share: {"answer": 1 / 0})
    assert log.run("one", lambda share: {"answer": 1}) == {"answer": 1}


def test_a_log_shows_the_step_and_how_far_it_is(tmp_path):
    shown = []
    log = JobLog(tmp_path, {}, lambda step, share: shown.append((step, share)))
    log.run("one", lambda share: share(0.5))
    assert shown == [("one", 0.0), ("one", 0.5)]


@pytest.mark.parametrize("content", ["", "[]", '{"result": 1}', '{"result": 1, "result": 2, "seconds": 0}'])
def test_a_damaged_step_is_told_by_its_file(tmp_path, content):
    log = open_log(tmp_path)
    log.run("one", lambda share: 1)
    (tmp_path / "one.json").write_text(content)
    with pytest.raises(InputError, match=r"one\.json: "):
        log.run("one", lambda share: 1)


def test_another_job_in_the_same_folder_is_refused(tmp_path):
    open_log(tmp_path / "steps", seed=1)
    with pytest.raises(InputError, match="choose another --out"):
        open_log(tmp_path / "steps", seed=2)


def test_a_run_of_other_code_is_refused(tmp_path, monkeypatch):
    open_log(tmp_path / "steps")
    monkeypatch.setattr("olt_sft_recipes.demo.job_log.code_version", lambda: "another")
    with pytest.raises(InputError, match="version of the code"):
        open_log(tmp_path / "steps")


def test_an_unusable_video_leaves_no_folder(tmp_path):
    video = tmp_path / "notes.mp4"
    video.write_text("not a video")
    with pytest.raises(InputError, match=r"notes\.mp4"):
        run_demo(tmp_path / "out", SMALL, video)
    assert not (tmp_path / "out").exists()


def test_what_was_left_out_is_kept_with_its_reason():
    clip = {"left_out": [{"what": "camera_rear", "why": "not wanted"}], "clip": {"no_sample_reason": "too short"}}
    drives = [{"what": "rendering", "why": "nobody looks"}, {"what": "tests", "why": "far away", "count": 3}]
    policies = {"one": {"left_out": drives}, "two": {"left_out": drives[:1]}}
    clips = {"input": clip, "training": {"frames_left_out_of_each_view": 7}}
    left_out = [word_omission(Omission(**record)) for record in list_left_out(clips, {"policies": policies})]
    assert left_out == [
        "camera_rear: not wanted",
        "policy samples of the input clip: too short",
        "7 frames of each view of the training clips: no sample of these clips shows them",
        "rendering: nobody looks",
        "3 tests: far away",
    ]


def comparable(summary):
    return json.dumps({key: value for key, value in summary.items() if key not in ("timings", "machine")})


@pytest.mark.slow
def test_the_main_job_runs_resumes_and_does_not_depend_on_the_number_of_workers(tmp_path):
    summary = run_demo(tmp_path / "one", SMALL, workers=1)
    assert (tmp_path / "one" / "report.html").stat().st_size > 10_000
    report = (tmp_path / "one" / "report.html").read_text()
    assert "What is in doubt:" in report and "acceleration variance (m²/s⁴)" in report and "2 GT and 5 Syn" in report
    assert comparable(json.loads((tmp_path / "one" / "summary.json").read_text())) == comparable(summary)
    assert summary["input"]["pose_errors"]["metric"]["ate_m"] < 5.0
    assert summary["input"]["clip"]["views"][FRONT_WIDE]["kind"] == "rendered"
    (tmp_path / "one" / "steps" / "closed_loop.json").unlink()
    assert comparable(run_demo(tmp_path / "one", SMALL, workers=1)) == comparable(summary)
    assert comparable(run_demo(tmp_path / "two", SMALL, workers=2)) == comparable(summary)


@pytest.mark.slow
def test_a_five_frame_video_runs_to_the_end(tmp_path, make_textured_drive):
    video = tmp_path / "five.mp4"
    write_video(video, make_textured_drive(5), 25.0)
    summary = run_demo(tmp_path / "out", replace(SMALL, long_tail_clips=1), video, workers=2)
    assert summary["input"]["clip"]["no_sample_reason"]
    assert summary["input"]["clip"]["views"][FRONT_WIDE]["kind"] == "observed"
    assert any(record["what"] == "policy samples of the input clip" for record in summary["left_out"])


@pytest.mark.parametrize(
    ("score", "interval", "separated", "said"),
    [
        (-0.3, [-0.4, -0.2], True, r"The mixtures differ. .*-0.300 \(95 %: -0.400 to -0.200\) on 9 scenes.$"),
        (0.1, [-0.1, 0.3], False, r"No difference between the mixtures is supported. .*\+0.100 .*launch_sft.md"),
        (0.1, None, False, r"No difference .*\(95 %: not measured\)"),
        (None, None, False, r"No difference .* could not be compared: no scene"),
    ],
)
def test_the_verdict_says_whether_a_difference_is_supported(score, interval, separated, said):
    pair = {"scenes": 9, "score": score, "score_interval": interval, "separated": separated}
    pairs = [
        {"first": RECIPES[0], "second": "standing", "separated": True},
        {"first": RECIPES[0], "second": RECIPES[1], **pair},
    ]
    assert re.search(said, word_verdict({"closed_loop": {"comparison": {"differences": pairs}}}))


@pytest.mark.parametrize(("scenes", "few"), [(5, True), (6, False)])
def test_too_few_scenes_are_told(scenes, few):
    pair = {"first": RECIPES[0], "second": RECIPES[1], "scenes": scenes, "score": 0.1, "score_interval": [-0.1, 0.3]}
    verdict = word_verdict({"closed_loop": {"comparison": {"differences": [pair | {"separated": False}]}}})
    assert ("Fewer than 6 scenes cannot tell." in verdict) is few


def test_the_demo_judges_on_enough_scenes_to_tell():
    assert len(plan_scenes(DemoSettings())["evaluation"]) >= FEWEST_SCENES
