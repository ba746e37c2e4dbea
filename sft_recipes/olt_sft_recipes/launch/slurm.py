"""One self-contained batch file for SLURM: both stages, with the checks between them."""

import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from olt_generator.errors import InputError
from olt_sft_recipes.launch.torchrun import PORT, to_shell

_BATCH = """\
#!/bin/bash
#SBATCH --job-name=olt-sft
#SBATCH --nodes={nodes}
#SBATCH --ntasks-per-node=1
#SBATCH --gpus-per-node={gpus}
#SBATCH --output={log}
{options}
# Submit with sbatch. Submitted again, it keeps the stages that are finished. Every node sees the same paths.
set -euo pipefail
export PYTHONUNBUFFERED=1 HYDRA_FULL_ERROR=1
out={out}
olt={olt}
mapfile -t hosts < <(scontrol show hostnames "$SLURM_JOB_NODELIST")
cd {recipe}

follow() {{  # STAGE: shows the log on standard input, keeps it, and stops at a silent failure
    if [ -x "$olt" ]; then
        "$olt" sft follow "$out" --stage "$1"
    else
        echo "Stage $1 is not watched: $olt is not on this node" >&2
        tee -a "$out/logs/stage$1.log"
    fi
}}

run_on_all() {{  # NAME ARGUMENT...: one torchrun on every node, which meet at the first
    local name=$1
    shift
    srun --kill-on-bad-exit=1 {torchrun} --nnodes "$SLURM_NNODES" --rdzv_backend c10d \\
        --rdzv_endpoint "${{hosts[0]}}:{port}" --rdzv_id "$SLURM_JOB_ID-$name" "$@" 2>&1
}}

run_stage() {{  # STAGE CHECKPOINT ARGUMENT...: trains until this checkpoint is there, whole
    local stage=$1 checkpoint=$2
    shift 2
    local folder
    folder=$(dirname "$checkpoint")
    if [ -f "$folder/finished.json" ]; then
        if [ -x "$olt" ]; then  # stops where Stage 1 was trained anew since
            "$olt" sft follow "$out" --stage "$stage" --kept
        else
            echo "Stage $stage is finished and kept, and not looked at: $olt is not on this node" >&2
        fi
        return
    fi
    if [ -e "$folder" ]; then
        mv "$folder" "${{folder}}_interrupted_$SLURM_JOB_ID"
    fi
    run_on_all "$stage" "$@" | follow "$stage"
    if [ ! -f "$checkpoint/model.safetensors.index.json" ]; then
        echo "Stage $stage left no $checkpoint with an index: nothing goes on from here" >&2
        exit 1
    fi
    if [ ! -x "$olt" ]; then  # noted as olt does, which looks at it later where it is there
        printf '{{"stage": %d, "checkpoint": "%s", "checked": null}}\\n' "$stage" "$checkpoint" \\
            > "$folder/finished.json"
    fi
}}
{before}{stages}{evaluation}"""


def write_batch(
    out: Path,
    recipe: Path,
    torchrun: str,
    olt: str,
    nodes: int,
    gpus: int,
    stages: Sequence[tuple[int, Path, Sequence[str]]],
    options: Sequence[str] = (),
    before: Sequence[str] = (),
    evaluation: Sequence[str] = (),
) -> str:
    """The batch file as text.

    Args:
        out, recipe: folders of the launch and of the recipe, absolute.
        torchrun, olt: programs, absolute.
        nodes, gpus: machines, and processes on each.
        stages: number, last checkpoint and arguments behind `torchrun` and its rendezvous, of each stage.
        options: further options of sbatch, such as "--partition=h100".
        before: commands of a shell that run once before the stages.
        evaluation: arguments of the recipe's evaluation, which runs at the end; none without validation clips.

    Raises:
        InputError: an option is none, or one that the batch file sets itself.
    """
    for option in options:
        _check_option(option)
    # sbatch replaces %j by the number of the job, and %% by %.
    log = str(out / "logs").replace("%", "%%") + "/slurm-%j.log"
    return _BATCH.format(
        nodes=nodes,
        gpus=gpus,
        log=_in_directive(log),
        options="".join(f"#SBATCH {option}\n" for option in options),
        out=shlex.quote(str(out)),
        olt=shlex.quote(olt),
        recipe=shlex.quote(str(recipe)),
        torchrun=shlex.quote(torchrun),
        port=PORT,
        before="".join(f"\n{command}\n" for command in before),
        stages="".join(
            f"\nrun_stage {stage} {shlex.quote(str(checkpoint))} {to_shell(words)}\n"
            for stage, checkpoint, words in stages
        ),
        evaluation=f'\nrun_on_all evaluation {to_shell(evaluation)} | tee -a "$out/logs/evaluation.log"\n'
        if evaluation
        else "",
    )


def _check_option(option: str) -> None:
    if not option.startswith("--") or not option.isprintable():
        raise InputError(f"--slurm-option {option!r}: write an option of sbatch in one word, such as --partition=h100")
    name = re.split("[= ]", option)[0]
    if name in ("--nodes", "--output") or name.startswith(("--ntasks", "--gpus")):
        raise InputError(f"--slurm-option {option}: the batch file says it itself; give --nodes, --gpus or --out")


def _in_directive(text: str) -> str:
    """A value on an #SBATCH line, which sbatch splits at spaces outside double quotes."""
    if '"' in text or "\\" in text:
        raise InputError(f"{text}: sbatch cannot be given this name; choose a folder without quotes and backslashes")
    return f'"{text}"'
