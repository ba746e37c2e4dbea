"""Are the checkpoint folders complete, and do they belong together?"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from olt_generator.errors import InputError
from olt_sft_recipes.preflight.checkpoint_folder import CONFIG, CheckpointFolder, look_at_folder
from olt_sft_recipes.preflight.data_rows import spread
from olt_sft_recipes.preflight.plan import PreflightPlan
from olt_sft_recipes.preflight.profiles import PROFILES
from olt_sft_recipes.preflight.rows import Row, RowMaker
from olt_sft_recipes.preflight.safetensors_files import StoredTensor, same_start, starts_finite
from olt_sft_recipes.preflight.token_rows import config_rows, pixel_row, unlike_tokens, vocabulary_rows
from olt_toolkit.runtime.json_files import read_json

ROWS = RowMaker("checkpoint")
VLM = "vlm."
PREFIXES = (VLM, "expert.", "action_in_proj.", "action_out_proj.")
"""Of the tensors of a released checkpoint."""
NAMES = (
    "vlm.model.language_model.embed_tokens.weight",
    "vlm.model.language_model.norm.weight",
    "vlm.lm_head.weight",
    "vlm.model.visual.patch_embed.proj.weight",
    "vlm.model.visual.pos_embed.weight",
    "expert.norm.weight",
)
"""Of tensors outside of its layers. A tensor that a layer lacks shows by the other layers."""
_COMPARED, _COMPARED_BYTES = 16, 1 << 16
_STATE, _SMALL_JSON = "trainer_state.json", 64 << 20


def checkpoint_rows(plan: PreflightPlan) -> tuple[list[Row], CheckpointFolder | None]:
    """Rows of the base, of Stage 1 and of the vocabulary; and the base, where one was given."""
    profile, rows = PROFILES[plan.policy], []
    base = None
    if plan.base is None:
        rows.append(ROWS.not_checked("base", "--base", "no folder of the released checkpoint was given"))
    else:
        base, found = look_at_folder("base", plan.base)
        rows += found
        rows += _prefix_rows(base)
        rows += config_rows(base, profile, plan.policy, plan.base_is_rewritten)
        rows.append(_dtype_row(base))
    rows += _stage1_rows(plan, base)
    if plan.vlm is None:
        why = f"no folder of {profile.vlm} was given"
        rows.append(ROWS.not_checked("vlm processor", "--vlm", why, "its files must be there where the run is offline"))
    else:
        rows += vocabulary_rows(plan.vlm, profile)
    return rows, base


def _prefix_rows(base: CheckpointFolder) -> Iterator[Row]:
    if not base.tensors:
        return
    counts = {prefix: sum(name.startswith(prefix) for name in base.tensors) for prefix in PREFIXES}
    missing = [f"no tensor {prefix}*" for prefix, count in counts.items() if not count]
    missing += [f"no tensor {name}" for name in NAMES if name not in base.tensors]
    stacks = [f"{VLM}model.language_model.layers", "expert.layers"]
    layers = {stack: _count_layers(base, stack) for stack in stacks}
    if len(set(layers.values())) > 1:
        told = ", ".join(f"{count} of {stack}" for stack, count in layers.items())
        missing.append(f"the expert meets the language model layer by layer, and there are {told}")
    good = ", ".join(f"{count} {prefix}*" for prefix, count in counts.items())
    yield ROWS.judge("base tensors", base.root, missing, good, "this is not the whole release; fetch it again")


def _count_layers(base: CheckpointFolder, stack: str) -> int:
    return sum(name.startswith(f"{stack}.") and name.endswith("self_attn.q_proj.weight") for name in base.tensors)


def _dtype_row(base: CheckpointFolder) -> Row:
    """Weights keep the type of the checkpoint in training, whatever `model_dtype` says."""
    names = {"bfloat16": "BF16", "float16": "F16", "float32": "F32"}
    told = base.config.get("model_dtype", "bfloat16")
    if not base.tensors or told not in names:
        return ROWS.not_checked(
            "base dtype", base.root, f"no tensors could be read, or model_dtype {told!r} is unknown"
        )
    # Beside weights, the projections of actions hold buffers, which may be of another type.
    weights = [name for name in base.tensors if name.startswith((VLM, "expert."))]
    odd = [f"{name} is {base.tensors[name].dtype}" for name in weights if base.tensors[name].dtype != names[told]]
    good = f"{len(weights)} weights are {names[told]}, as model_dtype says"
    return ROWS.judge(
        "base dtype", base.root, odd, good, "set model_dtype to the type of the weights, or fetch them again"
    )


def _stage1_rows(plan: PreflightPlan, base: CheckpointFolder | None) -> Iterator[Row]:
    alone = [stage.stage for stage in plan.stages] == [2]
    if plan.stage1 is None:
        if alone:
            found = "Stage 2 alone would train on the language model of the base"
            yield ROWS.failed("stage 1", "--stage1", found, "give the checkpoint-N of Stage 1, or run both stages")
        return
    folder, rows = look_at_folder("stage 1", plan.stage1)
    yield from rows
    yield from _stage1_config_rows(plan, folder, base)
    if not folder.tensors:
        return
    adapters = [name for name in folder.tensors if "lora_" in name or ".base_layer." in name]
    if adapters:
        found = f"{len(adapters)} tensors of adapters, as {adapters[0]}, which Stage 2 cannot load"
        yield ROWS.failed("stage 1 adapters", plan.stage1, found, "merge them into the weights")
        return
    tensors = _vlm_tensors(folder.tensors)
    if base is None or not base.tensors:
        yield ROWS.not_checked("stage 1 fits", plan.stage1, "there is no base to hold it against")
        return
    wanted = _vlm_tensors({name: tensor for name, tensor in base.tensors.items() if name.startswith(VLM)})
    yield _fit_row(plan.stage1, tensors, wanted)
    yield _trained_row(plan.stage1, tensors, wanted)


def _stage1_config_rows(plan: PreflightPlan, folder: CheckpointFolder, base: CheckpointFolder | None) -> Iterator[Row]:
    """Whether Stage 1 was trained with the image tokens and the ids of the base, and to its end."""
    where, config = folder.root / CONFIG, folder.config
    if config:
        yield pixel_row("stage 1 pixel limits", config, PROFILES[plan.policy], where)
        wrong, compared = ([], 0) if base is None else unlike_tokens(base.config, config)
        if compared:
            good = f"{compared} entries about trajectory tokens are those of the base"
            yield ROWS.judge("stage 1 tokens", where, wrong, good, "take a Stage 1 that started from this base")
        else:
            yield ROWS.not_checked(
                "stage 1 tokens", where, "there is no base, or it and Stage 1 share no entry of them"
            )
    yield _finished_row(folder.root)


def _finished_row(root: Path) -> Row:
    """Whether the Trainer's own notes in the folder are those of its last step."""
    check, path = "stage 1 finished", root / _STATE
    if not path.is_file():
        return ROWS.not_checked(check, path, "there is no such file")
    try:
        state = read_json(path, "notes of the Trainer", _SMALL_JSON)
    except InputError as error:
        return ROWS.failed(check, path, str(error), "fetch or copy the folder again")
    step, steps = (state.get(key) if isinstance(state, dict) else None for key in ("global_step", "max_steps"))
    if not isinstance(step, int) or not isinstance(steps, int):
        return ROWS.not_checked(check, path, "it tells neither global_step nor max_steps")
    named = root.name.removeprefix("checkpoint-")
    if root.name != named and named != str(step):
        found = f"the folder is called {root.name}, and was written at step {step}: files of two runs or a renamed one"
        return ROWS.failed(check, path, found, "take the folder as Stage 1 wrote it")
    if step < steps:
        return ROWS.note(check, path, f"step {step} of {steps}: not its last", "take the last one unless this is meant")
    return ROWS.passed(check, path, f"step {step} of {steps}")


def _vlm_tensors(tensors: dict[str, StoredTensor]) -> dict[str, StoredTensor]:
    """Those that Stage 2 would take, without their prefix: all with the prefix, or all where none has it."""
    prefixed = {name.removeprefix(VLM): tensor for name, tensor in tensors.items() if name.startswith(VLM)}
    return prefixed or tensors


def _fit_row(root: Path, found: dict[str, StoredTensor], wanted: dict[str, StoredTensor]) -> Row:
    """The recipe refuses a name that does not match; one that is missing it passes over without a word."""
    missing, strange = sorted(wanted.keys() - found.keys()), sorted(found.keys() - wanted.keys())
    other = sorted(name for name in wanted.keys() & found.keys() if not found[name].fits(wanted[name]))
    wrong = [f"{len(missing)} of {len(wanted)} tensors are missing, as {missing[0]}"] if missing else []
    wrong += [f"{len(strange)} tensors are unknown, as {strange[0]}"] if strange else []
    wrong += [f"{name} is {found[name].word()}, the base has {wanted[name].word()}" for name in other[:1]]
    good = f"{len(found)} tensors of the language model, by name, type and shape those of the base"
    return ROWS.judge("stage 1 fits", root, wrong, good, "take the checkpoint that Stage 1 wrote for this base")


def _trained_row(root: Path, found: dict[str, StoredTensor], base: dict[str, StoredTensor]) -> Row:
    """Whether weights are finite and others than the base's, by the first bytes of matrices spread over the model."""
    both = sorted(name for name in found.keys() & base.keys() if len(found[name].shape) > 1)
    compared = spread(both, _COMPARED)
    if not compared:
        return ROWS.not_checked("stage 1 trained", root, "no tensor is in both folders")
    equal = _count_equal([(found[name], base[name]) for name in compared])
    said = f"{equal} of {len(compared)} tensors that were compared begin as those of the base do"
    wrong = [f"{said}: Stage 1 did not train, or this is the base"] if equal == len(compared) else []
    endless = [name for name in compared if not starts_finite(found[name], _COMPARED_BYTES)]
    wrong += [f"{len(endless)} tensors hold NaN or infinite values, as {endless[0]}"] if endless else []
    return ROWS.judge("stage 1 trained", root, wrong, said, "take the checkpoint-N that Stage 1 wrote")


def _count_equal(pairs: Sequence[tuple[StoredTensor, StoredTensor]]) -> int:
    return sum(same_start(one, other, _COMPARED_BYTES) for one, other in pairs)
