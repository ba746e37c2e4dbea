"""A checkpoint folder in the format of Hugging Face: configuration, index and shards."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from olt_generator.errors import InputError
from olt_sft_recipes.preflight.rows import Row, RowMaker, name_first
from olt_sft_recipes.preflight.safetensors_files import StoredTensor, read_header
from olt_toolkit.runtime.json_files import read_json

CONFIG, INDEX, SINGLE_FILE = "config.json", "model.safetensors.index.json", "model.safetensors"
_SMALL_JSON = 64 << 20
_FETCH = "fetch or copy the folder again"
_LAYER = re.compile(r"^(?P<stack>.*\.(?:layers|blocks))\.(?P<number>\d+)\.(?P<rest>.+)$")
ROWS = RowMaker("checkpoint")


@dataclass
class CheckpointFolder:
    """What could be read of one: its configuration, and its tensors by name; empty where they cannot be read."""

    root: Path
    config: dict[str, Any] = field(default_factory=dict)
    tensors: dict[str, StoredTensor] = field(default_factory=dict)
    whole: bool = False


def look_at_folder(name: str, root: Path, single_file: bool = False) -> tuple[CheckpointFolder, list[Row]]:
    """Read configuration, index and the header of every shard.

    Args:
        name: what rows call it, such as "base".
        root: the folder.
        single_file: whether one `model.safetensors` without index is right, as the recipes' loaders do not think.
    """
    folder = CheckpointFolder(root)
    rows = [_read_config(name, folder)]
    files, index_rows = _find_shards(name, folder, single_file)
    rows += index_rows
    if files is None:
        return folder, rows
    rows += _read_shards(name, folder, files)
    folder.whole = all(row.verdict != "failed" for row in rows)
    rows += _check_layers(name, folder)
    return folder, rows


def _read_config(name: str, folder: CheckpointFolder) -> Row:
    path = folder.root / CONFIG
    try:
        content = read_json(path, "configuration", _SMALL_JSON)
    except InputError as error:
        return ROWS.failed(f"{name} {CONFIG}", path, str(error), _FETCH)
    if not isinstance(content, dict):
        return ROWS.failed(f"{name} {CONFIG}", path, "it is no JSON object", _FETCH)
    folder.config = content
    return ROWS.passed(f"{name} {CONFIG}", path, f"model type {content.get('model_type', 'not told')}")


def _find_shards(name: str, folder: CheckpointFolder, single_file: bool) -> tuple[dict[str, str] | None, list[Row]]:
    """The file of every tensor as the index has it; None where there is none that could be looked at."""
    check, path, single = f"{name} index", folder.root / INDEX, folder.root / SINGLE_FILE
    if not path.exists():
        if single.exists() and single_file:
            return {}, []
        found = (
            f"{SINGLE_FILE} stands alone: the recipes' loader needs the index" if single.exists() else "no such file"
        )
        action = "save it again with a small shard size, which writes an index" if single.exists() else _FETCH
        return None, [ROWS.failed(check, path, found, action)]
    try:
        index = read_json(path, "index of shards", _SMALL_JSON)
    except InputError as error:
        return None, [ROWS.failed(check, path, str(error), _FETCH)]
    files = index.get("weight_map") if isinstance(index, dict) else None
    if not isinstance(files, dict) or not files or not all(_is_plain(file) for file in files.values()):
        return None, [ROWS.failed(check, path, "it has no weight_map of tensors to files beside it", _FETCH)]
    rows = [ROWS.passed(check, path, f"{len(files)} tensors in {len(set(files.values()))} shards")]
    if single.exists() and SINGLE_FILE not in files.values():
        found = f"it lies beside {INDEX}; loading by name takes this file instead of the shards"
        rows.append(ROWS.failed(f"{name} stray file", single, found, "move it out of the folder"))
    return files, rows


def _is_plain(file: object) -> bool:
    return isinstance(file, str) and file.endswith(".safetensors") and Path(file).name == file


def _read_shards(name: str, folder: CheckpointFolder, files: dict[str, str]) -> Iterator[Row]:
    shards = sorted(set(files.values())) or [SINGLE_FILE]
    problems, size = [], 0
    for shard in shards:
        try:
            tensors = read_header(folder.root / shard)
        except InputError as error:
            problems.append(str(error))
            continue
        folder.tensors |= tensors
        size += sum(tensor.size for tensor in tensors.values())
        listed = {tensor for tensor, file in files.items() if file == shard}
        if files and listed != tensors.keys():
            odd = sorted(listed ^ tensors.keys())
            side = "lacks" if odd[0] in listed else "holds, and the index does not,"
            problems.append(f"{folder.root / shard}: it {side} {odd[0]} ({len(odd)} tensors differ)")
    types = Counter(tensor.dtype for tensor in folder.tensors.values())
    told = ", ".join(f"{count} {dtype}" for dtype, count in types.most_common())
    good = f"{len(shards)} of {len(shards)} there, as long as their headers say: {size / 1e9:.4g} GB; {told}"
    yield ROWS.judge(f"{name} shards", folder.root, problems, good, _FETCH)
    yield from _check_names(name, folder, shards)


def _check_names(name: str, folder: CheckpointFolder, shards: Sequence[str]) -> Iterator[Row]:
    """Shards that are called `...-of-0000n` are n, and no other lies about."""
    counts = {match[1] for shard in shards if (match := re.search(r"-of-(\d+)\.safetensors$", shard))}
    wrong = [
        f"the index names {len(shards)} shards, their names say {int(count)}"
        for count in counts
        if int(count) != len(shards)
    ]
    strangers = sorted(path.name for path in folder.root.glob("*.safetensors") if path.name not in shards)
    strangers = [stranger for stranger in strangers if stranger != SINGLE_FILE]
    if wrong:
        yield ROWS.failed(f"{name} shard names", folder.root, name_first(wrong), _FETCH)
    if strangers:
        found = f"{len(strangers)} files belong to no tensor of the index, as {strangers[0]}"
        yield ROWS.note(f"{name} shard names", folder.root, found, "take them out if they are left over")


def _check_layers(name: str, folder: CheckpointFolder) -> Iterator[Row]:
    """Layers of one stack hold the same tensors: one that is missing shows without knowing the architecture."""
    stacks: dict[str, dict[int, dict[str, tuple[str, tuple[int, ...]]]]] = {}
    for tensor_name, tensor in folder.tensors.items():
        if match := _LAYER.match(tensor_name):
            layers = stacks.setdefault(match["stack"], {})
            layers.setdefault(int(match["number"]), {})[match["rest"]] = (tensor.dtype, tensor.shape)
    if not stacks or not folder.whole:
        return
    wrong = []
    for stack, layers in stacks.items():
        if sorted(layers) != list(range(len(layers))):
            absent = sorted(set(range(max(layers) + 1)) - layers.keys())
            wrong.append(f"{stack}: layer {absent[0]} of {max(layers) + 1} is missing")
        names: Counter[str] = Counter(rest for layer in layers.values() for rest in layer)
        for rest, count in names.items():
            if count < len(layers):
                lacking = next(number for number, layer in sorted(layers.items()) if rest not in layer)
                wrong.append(f"{stack}.{lacking}.{rest} is missing, which {count} of {len(layers)} layers have")
        for rest in names:
            kinds = Counter(layer[rest] for layer in layers.values() if rest in layer)
            if len(kinds) > 1:
                odd = next(number for number, layer in layers.items() if layer.get(rest) == kinds.most_common()[-1][0])
                wrong.append(f"{stack}.{odd}.{rest} is another type or shape than in other layers")
    good = ", ".join(f"{len(layers)} of {stack}" for stack, layers in stacks.items())
    yield ROWS.judge(f"{name} layers", folder.root, wrong, f"layers alike: {good}", _FETCH)
