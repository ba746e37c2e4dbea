"""The batch file, data of a mixture, and saturated tokens."""

import json
import subprocess
from pathlib import Path

import pytest

from olt_datasets import compose_mixture, read_clip_tables
from olt_datasets.export.contents import contents_of_mixture
from olt_datasets.export.pai import export_pai
from olt_datasets.mixtures.recipe import read_recipe
from olt_generator.errors import InputError
from olt_sft_recipes.launch.pai_data import count_saturation, existing_data, planned_data
from olt_sft_recipes.launch.slurm import write_batch

STAGES = [(1, Path("/a b/run/stage1/checkpoint-6"), ["--nproc_per_node", "8", "-m", "x", "paths.output_dir='/a b/it'"])]
FAKES = {
    "scontrol": "echo node0\necho node1",
    "srun": 'echo "srun $*" >> "$LOG"; echo printed\n'
    '[ -z "$MAKES" ] || { mkdir -p "$MAKES"; touch "$MAKES/model.safetensors.index.json"; }',
}


def batch(out, olt="/no/olt", recipe=None, options=(), evaluation=()):
    stages = [(1, out / "stage1" / "checkpoint-6", STAGES[0][2])]
    return write_batch(out, recipe or out, "/env/bin/torchrun", olt, 2, 8, stages, options, (), evaluation)


def run_batch(tmp_path, text, makes):
    folder = tmp_path / "bin"
    folder.mkdir(exist_ok=True)
    for name, body in FAKES.items():
        (folder / name).write_text(f"#!/bin/bash\n{body}\n")
        (folder / name).chmod(0o755)
    environment = {"PATH": f"{folder}:/usr/bin:/bin", "LOG": str(tmp_path / "log"), "MAKES": str(makes or "")}
    environment |= {"SLURM_JOB_NODELIST": "node[0-1]", "SLURM_NNODES": "2", "SLURM_JOB_ID": "17"}
    return subprocess.run(["bash"], input=text, text=True, env=environment, capture_output=True, check=False)


def test_the_batch_file_is_a_shell_script_and_quotes_paths(tmp_path):
    text = batch(tmp_path / "a b's run", options=["--partition=h100", "--account=me"])
    assert subprocess.run(["bash", "-n"], input=text, text=True, check=False).returncode == 0
    directives = [line for line in text.splitlines() if line.startswith("#SBATCH")]
    assert directives[1:4] == ["#SBATCH --nodes=2", "#SBATCH --ntasks-per-node=1", "#SBATCH --gpus-per-node=8"]
    assert directives[-2:] == ["#SBATCH --partition=h100", "#SBATCH --account=me"]
    below = text[text.index("set -euo pipefail") :]
    assert "#SBATCH" not in below  # where sbatch would not read it


def test_the_batch_file_meets_at_the_first_node_and_goes_on_only_from_a_whole_checkpoint(tmp_path):
    out = tmp_path / "a run"
    (out / "logs").mkdir(parents=True)
    makes = out / "stage1" / "checkpoint-6"
    failed = run_batch(tmp_path, batch(out), None)
    assert failed.returncode == 1 and "with an index" in failed.stderr and "not watched" in failed.stderr
    assert run_batch(tmp_path, batch(out), makes).returncode == 0
    shown = (tmp_path / "log").read_text().splitlines()[-1]
    assert "--nnodes 2 --rdzv_backend c10d --rdzv_endpoint node0:29500 --rdzv_id 17-1" in shown
    assert shown.endswith("paths.output_dir='/a b/it'")


def test_the_evaluation_runs_on_all_nodes_at_the_end_and_its_log_is_kept(tmp_path):
    out = tmp_path / "a run"
    (out / "logs").mkdir(parents=True)
    text = batch(out, evaluation=["-m", "x.evaluate_hf", "evaluate.eval_ckpt='/a b/it'"])
    assert run_batch(tmp_path, text, out / "stage1" / "checkpoint-6").returncode == 0
    shown = (tmp_path / "log").read_text().splitlines()
    assert len(shown) == 2 and "--rdzv_id 17-evaluation -m x.evaluate_hf evaluate.eval_ckpt='/a b/it'" in shown[1]
    assert (out / "logs" / "evaluation.log").read_text() == "printed\n"


def test_a_finished_stage_is_kept_and_an_interrupted_one_put_aside(tmp_path):
    out = tmp_path / "run"
    (out / "logs").mkdir(parents=True)
    makes = out / "stage1" / "checkpoint-6"
    (out / "stage1" / "checkpoint-3").mkdir(parents=True)
    assert run_batch(tmp_path, batch(out), makes).returncode == 0
    assert (out / "stage1_interrupted_17" / "checkpoint-3").is_dir()
    note = json.loads((out / "stage1" / "finished.json").read_text())
    assert note == {"stage": 1, "checkpoint": str(makes), "checked": None}
    again = run_batch(tmp_path, batch(out), None)
    assert again.returncode == 0 and "finished and kept, and not looked at" in again.stderr


@pytest.mark.parametrize("fits", [True, False])
def test_a_finished_stage_is_looked_at_before_it_is_kept(tmp_path, fits):
    out, olt = tmp_path / "a run", tmp_path / "olt"
    (out / "stage1").mkdir(parents=True)
    (out / "stage1" / "finished.json").write_text("{}")
    olt.write_text(f'#!/bin/bash\necho "$*" > "$LOG"\nexit {0 if fits else 1}\n')
    olt.chmod(0o755)
    assert (run_batch(tmp_path, batch(out, str(olt)), None).returncode == 0) is fits
    assert (tmp_path / "log").read_text() == f"sft follow {out} --stage 1 --kept\n"


@pytest.mark.parametrize(
    "option", ["partition h100", "--nodes=9", "--gpus-per-node=h100:4", "--ntasks 3", "--output=elsewhere"]
)
def test_an_option_that_sbatch_cannot_read_or_the_batch_file_sets_is_refused(tmp_path, option):
    with pytest.raises(InputError, match="--slurm-option"):
        batch(tmp_path, options=[option])
    assert "#SBATCH --nodelist=node[1-9]\n" in batch(tmp_path, options=["--nodelist=node[1-9]"])


def test_sbatch_replaces_nothing_in_the_name_of_the_folder(tmp_path):
    text = batch(tmp_path / "50%x")
    assert f'#SBATCH --output="{tmp_path}/50%%x/logs/slurm-%j.log"' in text and f"out={tmp_path}/50%x\n" in text


def test_a_mixture_is_planned_as_it_is_exported_and_saturation_is_counted(tmp_path, braking_store):
    (tmp_path / "r.yaml").write_text(
        "name: r\ndescription: All.\nversion: 1\nsamples: 10\ncomponents:\n"
        "  - {name: all, where: {kind: GT}, share: 1.0, repeats: 8}\n"
    )
    mixture = compose_mixture(
        read_recipe(tmp_path / "r.yaml"), read_clip_tables([braking_store]), 0, allow_uncompared=True
    )
    contents = contents_of_mixture(mixture)
    planned = planned_data(contents, tmp_path / "pai")
    summary = export_pai(contents, tmp_path / "pai", verify=False)
    found = existing_data(tmp_path / "pai")
    assert (planned.chunk_ids, planned.clips) == (found.chunk_ids, found.clips) and found.clips == summary["clips"]
    before, after = count_saturation(planned), count_saturation(found)
    assert before is not None and after is not None and vars(before) == vars(after) | {"first_clip": before.first_clip}
    # From 2.5 s on 9 m/s² until it stands, 2.2 s: some 22 accelerations of the braking clip's samples, none of others.
    assert before.samples_touched == found.clips // 2
    assert 15 <= before.tokens / before.samples_touched <= 25
