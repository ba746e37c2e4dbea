"""Pictures and videos of rollouts."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from olt_closed_loop.commands import app
from olt_closed_loop.evaluation.drive_pictures import outline
from olt_closed_loop.evaluation.drive_videos import draw_frame
from olt_closed_loop.evaluation.drive_views import plan_deviations, view_drive
from olt_closed_loop.evaluation.evaluation import run_closed_loop
from olt_closed_loop.scenes.scene_file import write_scene
from olt_closed_loop.scoring.definitions import score_rollout
from olt_closed_loop.simulation.closed_loop import simulate
from olt_closed_loop.simulation.policies import ConstantVelocityPolicy
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.errors import InputError
from olt_toolkit.policy.contract import PlannedTrajectory

SHORT = SimulationSettings(duration_us=4_000_000)


class Aside:
    """Wants to be a little to the left, at once; at one time it plans nothing that can be followed."""

    name, cameras, image_size = "aside", (), (0, 0)

    def plan(self, observation):
        plan = ConstantVelocityPolicy().plan(observation)
        if observation.time_us == 2_500_000:
            return PlannedTrajectory(plan.xyz * np.nan, plan.rotation)
        return PlannedTrajectory(plan.xyz + np.array([0.0, 0.2, 0.0]), plan.rotation)


@pytest.fixture
def crash(straight_scene, moving_agent):
    """A drive into a slower car."""
    scene = straight_scene((moving_agent("slow", (25.0, 0.0), (4.0, 0.0)),))
    rollout = simulate(scene, ConstantVelocityPolicy())
    return view_drive(scene, rollout, score_rollout(scene, rollout))


def test_what_happened_is_told_in_order_with_its_agent(crash, straight_scene):
    assert [moment.text for moment in crash.moments] == ["hand-over", "front contact with automobile slow, at fault"]
    hit = crash.moments[1]
    assert (hit.bad, hit.agent_id, hit.time_us) == (True, "slow", crash.score.collisions[0].time_us)
    touching = outline(crash.ego, hit.time_us)[:, 0].max(), outline(crash.agents["slow"], hit.time_us)[:, 0].min()
    assert touching[0] == pytest.approx(touching[1], abs=1e-3)
    rollout = simulate(straight_scene(), Aside())
    moments = view_drive(straight_scene(), rollout, score_rollout(straight_scene(), rollout)).moments
    assert [(moment.time_us, moment.text) for moment in moments[:2]] == [
        (1_700_000, "hand-over"),
        (2_500_000, "plan refused"),
    ]


def test_the_deviation_is_that_from_the_plan_in_force(straight_scene):
    exact = simulate(straight_scene(), ConstantVelocityPolicy())
    assert np.nanmax(plan_deviations(exact)) < 1e-9
    for delay_us in (0, 300_000):
        aside = simulate(straight_scene(), Aside(), SimulationSettings(planner_delay_us=delay_us))
        deviations = plan_deviations(aside)

        assert 0.1 < np.nanmax(deviations) < 0.3
        np.testing.assert_array_equal(np.isnan(deviations), aside.timestamps_us <= 1_700_000)


def test_a_frame_shows_the_ego_the_agents_and_what_touches(crash):
    def count(frame, color):
        return int((np.abs(frame.astype(int) - color).max(axis=-1) < 12).sum())

    blue, brown, red = (31, 111, 235), (154, 52, 18), (196, 33, 42)
    before = draw_frame(crash, 20)
    row = int(np.searchsorted(crash.rollout.timestamps_us, crash.moments[1].time_us)) + 1
    during = draw_frame(crash, row)
    area = 64 * crash.scene.vehicle.length * crash.scene.vehicle.width
    assert count(before, blue) == pytest.approx(area, rel=0.1)
    assert count(before, brown) == pytest.approx(64 * 4.5 * 1.9, rel=0.1) and not count(before, red)
    assert count(during, red) > area and not count(during, blue)


def test_the_command_lists_and_draws(tmp_path):
    run = tmp_path / "run"
    arguments = ["nominal:0", "cyclists:1", "--policy", "standing", "--rollouts", "1", "--workers", "1"]
    CliRunner().invoke(app, ["run", *arguments, "--duration", "3", "--out", str(run)])
    listed = CliRunner().invoke(app, ["show", str(run), "--json"])
    assert listed.exit_code == 0, listed.output
    rows = json.loads(listed.stdout)["rollouts"]
    assert [(row["rollout"], row["seed"], row["plans_asked"], row["solves"]) for row in rows] == [
        (0, 0, 13, 13),
        (1, 0, 13, 13),
    ]
    assert rows[0]["plan_deviation_max"] is not None and rows[0]["failure_kind"] is None
    drawn = CliRunner().invoke(app, ["show", str(run), f"{rows[1]['scene']}:0", "--json"])
    assert drawn.exit_code == 0, drawn.output
    files = json.loads(drawn.stdout)["files"]
    assert files == [str(run / "shown" / name) for name in ("000001.png", "000001.mp4")]
    assert cv2.imread(files[0]).shape == (800, 1500, 3)
    video = cv2.VideoCapture(files[1])
    assert (video.get(cv2.CAP_PROP_FRAME_COUNT), video.get(cv2.CAP_PROP_FPS)) == (31, 10)
    table = CliRunner().invoke(app, ["show", str(run)])
    assert table.exit_code == 0 and rows[1]["scene"] in table.stdout
    every = CliRunner().invoke(app, ["show", str(run), "--all", "--no-video", "--out", str(tmp_path / "all"), "--json"])
    assert json.loads(every.stdout)["files"] == [str(tmp_path / "all" / f"00000{index}.png") for index in (0, 1)]


def test_what_cannot_be_shown_is_refused_in_words(straight_scene, tmp_path):
    def refuse(words, *arguments):
        result = CliRunner().invoke(app, ["show", *map(str, arguments)])
        assert result.exit_code and isinstance(result.exception, InputError) and words in str(result.exception)

    run_closed_loop([straight_scene()], "route", 1, settings=SHORT, out=tmp_path / "memory")
    refuse("cannot read this run: no such file", tmp_path)
    refuse("has no finished rollout 3", tmp_path / "memory", 3)
    refuse("was driven from memory", tmp_path / "memory", 0)
    path = write_scene(straight_scene(), tmp_path / "scene.usda")
    result = CliRunner().invoke(app, ["show", str(tmp_path / "memory"), "0", "--scene", str(path), "--no-video"])
    assert result.exit_code == 0, result.output
    run_closed_loop([str(path)], "route", 1, settings=SHORT, out=tmp_path / "file")
    write_scene(straight_scene(speed=9.0), path)
    refuse("is not what was driven any more", tmp_path / "file", 0)
    with pytest.raises(InputError, match="cannot be shown on scene"):
        rollout = simulate(straight_scene(), ConstantVelocityPolicy(), SHORT)
        view_drive(replace(straight_scene(), name="other"), rollout, score_rollout(straight_scene(), rollout))
