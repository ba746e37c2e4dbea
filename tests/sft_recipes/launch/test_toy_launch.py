"""The toy is launched end to end: plan, both stages, judgement, policy."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from olt_closed_loop import generate_scene
from olt_closed_loop.sensors.recorder import record_drive
from olt_datasets import compose_mixture, read_clip_tables
from olt_datasets.mixtures.recipe import parse_recipe
from olt_generator.errors import InputError
from olt_generator.trajectory import Trajectory
from olt_sft_recipes.launch import toy as launching
from olt_sft_recipes.launch.toy import HELD_OUT_SCENES, describe_toy, launch_toy
from olt_sft_recipes.toy.policy import load_toy
from olt_toolkit import BuildOptions, ClipStore, build_clip
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT
from olt_toolkit.runtime.command_line import run

STAGE = "num_train_epochs: 1\nper_device_train_batch_size: 4\nwarmup_steps: 1\neval_steps: 0.5\n"


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Two short drives, one to train on and one to judge by."""
    folder = ClipStore(tmp_path_factory.mktemp("launch") / "store")
    for seed, split in ((30, "train"), (31, "val")):
        scene = generate_scene("nominal", seed)
        kept = scene.ego.timestamps_us <= scene.ego.timestamps_us[0] + 9_000_000
        scene = replace(scene, ego=Trajectory(scene.ego.timestamps_us[kept], scene.ego.T_world_rig[kept]))
        recording = record_drive(scene, 32, 16, 10.0, DEFAULT_CONTRACT.cameras)
        options = BuildOptions(32, 16, use_reference_views=True, image_kind="rendered", split=split)
        folder.commit([folder.prepare(build_clip(recording, options).clip).clip_id])
    return folder.root


@pytest.fixture(scope="module")
def mixture(store):
    recipe = {"name": "one drive", "description": "", "version": 1, "samples": 10}
    parts = [{"name": "nominal", "where": {"kind": "GT"}, "share": 1.0, "repeats": 10}]
    clips = read_clip_tables([store])
    return compose_mixture(
        parse_recipe({**recipe, "components": parts}, "test"), clips, 0, HELD_OUT_SCENES, allow_uncompared=True
    )


@pytest.fixture
def stages(tmp_path):
    paths = [tmp_path / f"stage{number}.yaml" for number in (1, 2)]
    for number, path in enumerate(paths, 1):
        path.write_text(f"stage: {number}\n{STAGE}")
    return {"stage1": paths[0], "stage2": paths[1]}


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(launching, "VALIDATION_SCENES", ("nominal:900",))
    monkeypatch.setattr(launching, "VALIDATION_US", 2_500_000)


@pytest.mark.slow
def test_the_toy_is_trained_judged_and_drives(mixture, store, stages, tmp_path, capsys):
    planned = launch_toy(mixture, tmp_path / "out", stores=[store], dry_run=True, **stages)
    assert not (tmp_path / "out").exists() and planned.keys() == {"plan"}
    assert [(row["steps"], row["evaluations"], row["drives"]) for row in planned["plan"]["stages"]] == [
        (3, 2, 0),
        (3, 2, 2),
    ]
    result = launch_toy(mixture, tmp_path / "out", stores=[store], **stages)
    assert result["plan"] == planned["plan"]
    assert [stage["steps"] for stage in result["stages"]] == [3, 3]
    judged = result["stages"][1]["evaluations"]
    assert [evaluation["step"] for evaluation in judged] == [2, 3]
    assert all(evaluation["closed_loop"]["rollouts"] == 1 for evaluation in judged)
    assert load_toy(result["policy"]).cameras == DEFAULT_CONTRACT.cameras
    lines = "\n".join(describe_toy(result))
    assert f"policy: {tmp_path / 'out/policy'}" in lines and "closed loop:" in lines and "unchanged" in lines
    json.dumps(result, allow_nan=False)
    assert run(["sft", "status", str(tmp_path / "out")]) == 0
    assert "best: step" in capsys.readouterr().out
    again = launch_toy(mixture, tmp_path / "out", stores=[store], **stages)
    assert again == result


@pytest.mark.slow
def test_two_processes_train_the_same(mixture, store, stages, tmp_path):
    alone = launch_toy(mixture, tmp_path / "one", stores=[store], **stages)
    two = launch_toy(mixture, tmp_path / "two", stores=[store], processes=2, **stages)
    for one, other in zip(alone["stages"], two["stages"], strict=True):
        # The image encoder counts in bfloat16, which some processors round by the size of a batch.
        assert other["losses"] == pytest.approx(one["losses"], rel=2e-4)
    assert Path(two["policy"]).is_dir()


def test_what_cannot_be_launched_is_refused(mixture, tmp_path):
    with pytest.raises(InputError, match="1 or more"):
        launch_toy(mixture, tmp_path, processes=0)
