"""Stage 1's checkpoint on its way to Stage 2: complete, of the same tokens, and really the one that Stage 2 uses."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from olt_generator.errors import InputError
from olt_sft_recipes.launch.public_recipes import MAX_PIXELS, MIN_PIXELS
from olt_sft_recipes.preflight.checkpoint_folder import CheckpointFolder, look_at_folder
from olt_sft_recipes.preflight.rows import Verdict
from olt_sft_recipes.preflight.safetensors_files import StoredTensor
from olt_sft_recipes.preflight.token_rows import unlike_tokens

if TYPE_CHECKING:
    from torch import Tensor

VLM_PREFIX = "vlm."
_NAME = re.compile(r"checkpoint-(\d+)")
# Enough tensors to tell, and not so many that reading them holds up a training that is being followed.
SAMPLE_BYTES = 512 << 20


def checkpoints_of(folder: Path) -> dict[int, Path]:
    """The folders `checkpoint-N` of a stage by N, in rising order."""
    found = {int(match[1]): path for path in folder.glob("checkpoint-*") if (match := _NAME.fullmatch(path.name))}
    return dict(sorted(found.items()))


def read_checkpoint(path: Path) -> CheckpointFolder:
    """A folder whose configuration, index and shards are all there; InputError with what is not.

    Above all, a single `model.safetensors` without an index is refused: Stage 2 finds no tensor in it.
    """
    folder, rows = look_at_folder(path.name, path)
    failed = [row for row in rows if row.verdict is Verdict.FAILED]
    if failed:
        raise InputError("; ".join(f"{row.where}: {row.check}: {row.found}; {row.action}" for row in failed[:3]))
    return folder


def vlm_tensors(folder: CheckpointFolder) -> dict[str, StoredTensor]:
    """The tensors that the recipe takes for the vision-language model, without prefix: those of `vlm.`, or else all."""
    prefixed = {name: tensor for name, tensor in folder.tensors.items() if name.startswith(VLM_PREFIX)}
    return {name.removeprefix(VLM_PREFIX): tensor for name, tensor in (prefixed or folder.tensors).items()}


def check_pixel_budget(folder: CheckpointFolder) -> None:
    """InputError where `config.json` does not limit the pixels of an image.

    No override can: Stage 1 takes the limits from there alone. Without them an image is about 2,040 tokens, not 180.
    """
    found = {key: folder.config.get(key) for key in ("min_pixels", "max_pixels")}
    wanted = {"min_pixels": MIN_PIXELS, "max_pixels": MAX_PIXELS}
    if found != wanted:
        raise InputError(f"{folder.root / 'config.json'}: the pixel budget is {found}; write {wanted} into it")


def check_tokens(base: CheckpointFolder, trained: CheckpointFolder) -> None:
    """InputError where two checkpoints do not mean the same by the id of a trajectory token."""
    wrong, _ = unlike_tokens(base.config, trained.config)
    if wrong:
        raise InputError(
            f"{trained.root / 'config.json'}: {wrong[0]} ({base.root}): their trajectory tokens are not the same; both "
            "stages must start from one base"
        )


def check_stage1(path: Path, base_path: Path) -> "VlmComparison":
    """Look at what Stage 1 left before Stage 2 is given it.

    Raises:
        InputError: it is not complete, holds adapters that were not merged, lacks tensors of the base (which the recipe
            would take from the base in silence), has other tokens, types or shapes, no pixel budget or values that are
            not finite, or is the base, unchanged.
    """
    trained, base = read_checkpoint(path), read_checkpoint(base_path)
    mine, theirs = vlm_tensors(trained), vlm_tensors(base)
    adapters = [name for name in mine if "lora_" in name or ".base_layer." in name]
    if adapters:
        raise InputError(
            f"{path}: holds adapters ({adapters[0]}), which Stage 2 cannot load; merge them into the weights first"
        )
    missing, strange = sorted(theirs.keys() - mine.keys()), sorted(mine.keys() - theirs.keys())
    if missing or strange:
        what, name = ("lacks", missing[0]) if missing else ("holds", strange[0])
        raise InputError(
            f"{path}: {what} {name}, unlike {base_path} ({len(missing)} tensors missing, {len(strange)} more); what is "
            "missing stays as in the base without a word: train Stage 1 again"
        )
    check_pixel_budget(trained)
    check_tokens(base, trained)
    other = next((name for name in sorted(mine) if not mine[name].fits(theirs[name])), None)
    if other is not None:
        raise InputError(
            f"{path}: {other} is {mine[other].word()}, and {theirs[other].word()} in {base_path}; both stages must "
            "start from one base"
        )
    comparison = compare_vlm(path, path, base_path, SAMPLE_BYTES)
    if comparison.telling == 0:
        raise InputError(
            f"{path}: {comparison.compared} of its {comparison.of} tensors were compared with {base_path} and all are "
            "the same: Stage 1 changed nothing; look at its learning rate and its log"
        )
    return comparison


@dataclass(frozen=True)
class VlmComparison:
    """The vision-language model in a folder of Stage 2, held against Stage 1's.

    Attributes:
        of, compared: tensors of Stage 1's model, and how many of them were compared.
        telling: of these, those that Stage 1 changed, so that Stage 1's and the base's can be told apart.
        unlike: names of those that are not Stage 1's.
        as_base: how many of `unlike` are the base's.
    """

    of: int
    compared: int
    telling: int
    unlike: tuple[str, ...]
    as_base: int

    def refuse(self, stage1: Path, stage2: Path) -> None:
        """InputError where Stage 2 has another vision-language model than Stage 1 left."""
        if self.unlike:
            whose = "the released model's" if self.as_base == len(self.unlike) else "neither Stage 1's nor the base's"
            raise InputError(
                f"{stage2}: Stage 2 has the wrong vision-language model: {len(self.unlike)} of {self.compared} "
                f"compared tensors are not those of {stage1} but {whose}, first {self.unlike[0]}; before "
                "9299254 (2026-07-07) the recipe loads Stage 1 in vain: update it and train Stage 2 again"
            )

    def word(self) -> str:
        """One sentence."""
        return (
            f"{self.compared} of {self.of} tensors compared with Stage 1's: {len(self.unlike)} differ; "
            f"{self.telling} of them Stage 1 had changed"
        )


def compare_vlm(stage1: Path, stage2: Path, base: Path, most_bytes: int | None = None) -> VlmComparison:
    """Compare tensor by tensor, at the precision of Stage 2's; `most_bytes` takes a sample spread over the names.

    Raises:
        InputError: a value of Stage 1 or 2 is not finite.
    """
    folders = [vlm_tensors(read_checkpoint(path)) for path in (stage1, stage2, base)]
    names = _spread(folders[0], most_bytes)
    unlike, as_base, telling = [], 0, 0
    for name in names:
        one, two = (_read_finite(tensors, name) for tensors in folders[:2])
        released = _read(folders[2], name)
        telling += not _same(one, released)
        if not _same(one, two):
            unlike.append(name)
            as_base += _same(released, two)
    return VlmComparison(len(folders[0]), len(names), telling, tuple(unlike), as_base)


def check_expert(path: Path, base_path: Path, whole: bool) -> str:
    """Look at the action expert that Stage 2 left; says what was compared.

    Args:
        path, base_path: folders of Stage 2 and of the released checkpoint.
        whole: whether the training is at its end, by which something must have changed.

    Raises:
        InputError: tensors of the base's expert are missing, a value is not finite, or all are still the base's.
    """
    trained, base = read_checkpoint(path).tensors, read_checkpoint(base_path).tensors
    names = sorted(name for name in base if not name.startswith(VLM_PREFIX))
    missing = [name for name in names if name not in trained]
    if missing:
        raise InputError(
            f"{path}: lacks {missing[0]} of the action expert ({len(missing)} of {len(names)} tensors missing), so it "
            "cannot drive; train Stage 2 again"
        )
    chosen = _spread({name: base[name] for name in names}, SAMPLE_BYTES)
    changed = sum(not _same(_read(base, name), _read_finite(trained, name)) for name in chosen)
    if whole and not changed:
        raise InputError(
            f"{path}: {len(chosen)} of {len(names)} tensors of the action expert were compared with {base_path} and "
            "all are the same: Stage 2 changed nothing; look at its learning rate and its log"
        )
    return f"{changed} of {len(chosen)} compared tensors of the action expert differ from {base_path.name}"


def _spread(tensors: Mapping[str, StoredTensor], most_bytes: int | None) -> Sequence[str]:
    names = sorted(tensors)
    total = sum(tensor.size for tensor in tensors.values())
    if most_bytes is None or total <= most_bytes:
        return names
    step = -(-total // most_bytes)
    return names[::step]


def _same(left: "Tensor | None", right: "Tensor | None") -> bool:
    """Whether two tensors are there and equal, the left one at the precision of the right one."""
    if left is None or right is None or left.shape != right.shape:
        return False
    return left.to(right.dtype).equal(right)


def _read_finite(tensors: Mapping[str, StoredTensor], name: str) -> "Tensor | None":
    """A tensor of a trained model; InputError where it holds NaN or infinity, which nothing can be driven with."""
    tensor = _read(tensors, name)
    if tensor is not None and not tensor.isfinite().all():
        raise InputError(
            f"{tensors[name].file}: {name} holds NaN or infinite values: the training went astray; look at its losses, "
            "and train again with a lower learning rate"
        )
    return tensor


def _read(tensors: Mapping[str, StoredTensor], name: str) -> "Tensor | None":
    from safetensors import safe_open

    if name not in tensors:
        return None
    with safe_open(tensors[name].file, framework="pt") as file:
        stored = name if name in file.keys() else f"{VLM_PREFIX}{name}"  # noqa: SIM118 - not a dict
        return file.get_tensor(stored)
