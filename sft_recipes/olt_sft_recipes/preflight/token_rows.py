"""Are configuration, vocabulary and trajectory tokens of a checkpoint those that the recipe builds?

The recipe adds `<i0>`, `<i1>`, ... and special tokens to the vocabulary of the vision-language model, in this order,
and gives the future the first ids and the history those behind them; Alpamayo 2 the other way round. A mixed-up offset
trains without a message (docs/formats/alpamayo.md).
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from olt_generator.errors import InputError
from olt_sft_recipes.preflight.checkpoint_folder import CONFIG, CheckpointFolder
from olt_sft_recipes.preflight.profiles import FEWEST_SPECIAL_TOKENS, FIRST_TRAJECTORY_ID, SPECIAL_TOKENS, Profile
from olt_sft_recipes.preflight.rows import Row, RowMaker
from olt_toolkit.runtime.json_files import read_json

ROWS = RowMaker("checkpoint")
EMBEDDING = "language_model.embed_tokens.weight"
_TOKENIZER, _VOCABULARY, _MERGES = "tokenizer.json", "vocab.json", "merges.txt"
_TOKENIZER_CONFIG, _PROCESSOR = "tokenizer_config.json", ("preprocessor_config.json", "processor_config.json")
_LARGEST = 256 << 20
_SMALLEST = 2  # bytes of a JSON object
_ORIGINAL = "take the config.json of the release again"


# What the ids of trajectory tokens depend on.
_TOKEN_KEYS = (
    "vocab_size",
    "traj_vocab_size",
    "history_vocab_size",
    "future_vocab_size",
    "traj_token_start_idx",
    "traj_token_ids",
    "tokens_per_history_traj",
    "tokens_per_future_traj",
)
_TOKENIZERS = ("traj_tokenizer_cfg", "hist_traj_tokenizer_cfg")


def config_rows(
    folder: CheckpointFolder, profile: Profile, policy: str, rewritten_first: bool = False
) -> Iterator[Row]:
    """Rows about the `config.json` of the released checkpoint; its model type is another where it is rewritten."""
    config, where = folder.config, folder.root / CONFIG
    if not config:
        yield ROWS.not_checked("trajectory tokens", where, "there is no configuration")
        return
    if profile.model_type is not None:
        yield _model_type_row(config.get("model_type"), profile.model_type, policy, where, rewritten_first)
    yield _token_row(config, profile, where)
    yield pixel_row("pixel limits", config, profile, where)
    yield _vocabulary_row(folder, profile)


def _model_type_row(found: object, wanted: str, policy: str, where: Path, rewritten_first: bool) -> Row:
    newer, action = found == "alpamayo1_5", _ORIGINAL
    if newer and rewritten_first:
        return ROWS.passed("model type", where, f"{found}, which the launch rewrites to {wanted}")
    if newer:
        action = "rewrite it first: python scripts/convert_checkpoint.py to-a1 --input BASE --output BASE_A1"
    wrong = [] if found == wanted else [f"model_type is {found!r}, the recipe of {policy} reads {wanted!r}"]
    return ROWS.judge("model type", where, wrong, str(found), action)


def unlike_tokens(base: Mapping[str, Any], trained: Mapping[str, Any]) -> tuple[list[str], int]:
    """Where two configurations do not mean the same by the id of a trajectory token, and how many keys both have."""
    told, compared = [], 0
    for key in (*_TOKEN_KEYS, *_TOKENIZERS):
        if key not in base or key not in trained:
            continue
        one, other = (_bins(config[key]) if key in _TOKENIZERS else config[key] for config in (base, trained))
        compared += 1
        if one != other:
            told.append(f"{key} is {other!r:.60}, and {one!r:.60} in the base")
    return told, compared


def _bins(tokenizer: Any) -> Any:
    """What decides the ids; other entries name the class, which each package calls otherwise."""
    return tokenizer.get("num_bins") if isinstance(tokenizer, Mapping) else tokenizer


def _token_row(config: dict[str, Any], profile: Profile, where: Path) -> Row:
    """Numbers of tokens, and that the ids of history and future neither overlap nor change places."""
    wanted: dict[str, int] = {
        "tokens_per_history_traj": profile.history_tokens,
        "tokens_per_future_traj": profile.future_tokens,
    }
    if profile.history_first:
        wanted |= {"history_vocab_size": profile.history_bins, "future_vocab_size": profile.future_bins}
    else:
        wanted |= {"traj_vocab_size": profile.trajectory_vocabulary}
    wrong = [
        f"{key} is {config.get(key, 'absent')}, not {value}"
        for key, value in wanted.items()
        if config.get(key) != value
    ]
    for key, bins in {
        "traj_tokenizer_cfg": profile.future_bins,
        "hist_traj_tokenizer_cfg": profile.history_bins,
    }.items():
        tokenizer = config.get(key)
        if not isinstance(tokenizer, dict):
            wrong.append(f"{key} is {'absent' if tokenizer is None else 'no mapping'}")
        elif tokenizer.get("num_bins", bins) != bins:
            wrong.append(f"{key}.num_bins is {tokenizer['num_bins']}, not {bins}")
        elif profile.history_first and key.startswith("hist") and tokenizer.get("pad_origin_at_beginning", False):
            wrong.append(f"{key}.pad_origin_at_beginning is true, which makes 48 tokens and not 45")
    first = config.get("traj_token_start_idx", FIRST_TRAJECTORY_ID)
    if first != FIRST_TRAJECTORY_ID and not profile.history_first:
        wrong.append(f"traj_token_start_idx is {first}, the vocabulary gives <i0> the id {FIRST_TRAJECTORY_ID}")
    future = profile.history_bins if profile.history_first else 0
    history = 0 if profile.history_first else profile.future_bins
    good = (
        f"{profile.history_tokens} history and {profile.future_tokens} future tokens; future from <i{future}>, history "
        f"from <i{history}>"
    )
    return ROWS.judge("trajectory tokens", where, wrong, good, _ORIGINAL)


def pixel_row(check: str, config: Mapping[str, Any], profile: Profile, where: Path) -> Row:
    """Whether a configuration limits the pixels of an image as the release does; no override of a launch can."""
    limits = {"min_pixels": profile.min_pixels, "max_pixels": profile.max_pixels}
    wrong = [
        f"{key} is {config.get(key, 'absent')}, not {value}"
        for key, value in limits.items()
        if config.get(key) != value
    ]
    good = f"{profile.min_pixels:,} to {profile.max_pixels:,} pixels: 180 tokens an image of 1080 x 1920"
    action = "write both into config.json: without them an image becomes about 2,040 tokens"
    return ROWS.judge(check, where, wrong, good, action)


def _vocabulary_row(folder: CheckpointFolder, profile: Profile) -> Row:
    """Rows of the embedding are the vocabulary of the base, the trajectory tokens, and the special ones."""
    check, config = "vocabulary", folder.config
    name = next((name for name in folder.tensors if name.endswith(EMBEDDING)), None)
    if name is None:
        why = f"no tensor {EMBEDDING} could be read"
        return ROWS.not_checked(check, folder.root, why)
    rows = folder.tensors[name].shape[0]
    if profile.history_first:
        return _padded_row(check, folder, rows)
    special = SPECIAL_TOKENS if config.get("add_special_tokens", True) else FEWEST_SPECIAL_TOKENS
    wanted = FIRST_TRAJECTORY_ID + profile.trajectory_vocabulary + special
    told = config.get("vocab_size", wanted)
    wrong = [] if rows == wanted else [f"{name} has {rows} rows, not {wanted}"]
    wrong += [] if told == wanted else [f"vocab_size is {told}, not {wanted}"]
    good = f"{rows} = {FIRST_TRAJECTORY_ID} + {profile.trajectory_vocabulary} trajectory + {special} special tokens"
    return ROWS.judge(check, folder.root, wrong, good, "base and vocabulary do not belong together; fetch both again")


def _padded_row(check: str, folder: CheckpointFolder, rows: int) -> Row:
    """Alpamayo 2 pads its vocabulary to a multiple of 128; the length before that is not published."""
    wrong = [] if rows % 128 == 0 else [f"{rows} rows of the embedding are no multiple of 128"]
    return ROWS.judge(check, folder.root, wrong, f"{rows} rows, a multiple of 128", "fetch the folder again")


def vocabulary_rows(root: Path, profile: Profile) -> Iterator[Row]:
    """Rows about a folder of the vision-language model: processor, tokenizer, and the id that `<i0>` will get."""
    yield _processor_row(root)
    check, where = "vlm vocabulary", root / _TOKENIZER
    try:
        words = _read_vocabulary(root)
    except InputError as error:
        yield ROWS.failed(check, where, str(error), "fetch the folder again")
        return
    if words is None:
        yield ROWS.not_checked(
            check, where, f"there is no {_TOKENIZER}; {_VOCABULARY} and {_MERGES} alone tell no added tokens"
        )
        return
    if profile.history_first:
        yield ROWS.passed(check, where, f"{len(words)} words")
        return
    first = words.get("<i0>", len(words))
    known = [f"<i{number}>" for number in range(profile.trajectory_vocabulary) if f"<i{number}>" in words]
    wrong = []
    if known and len(known) != profile.trajectory_vocabulary:
        wrong.append(f"{len(known)} of {profile.trajectory_vocabulary} trajectory tokens are in it already")
    if known and any(words[word] != first + int(word[2:-1]) for word in known):
        wrong.append("the ids of its trajectory tokens do not follow each other")
    if first != FIRST_TRAJECTORY_ID:
        wrong.append(f"<i0> has or would get id {first}, the checkpoint was trained with {FIRST_TRAJECTORY_ID}")
    action = f"give the tokenizer of {profile.vlm} as it is published"
    yield ROWS.judge(check, where, wrong, f"{len(words)} words; <i0> has or gets id {first}", action)


def _processor_row(root: Path) -> Row:
    wrong = []
    if not any((root / name).is_file() for name in _PROCESSOR):
        wrong.append(f"no {_PROCESSOR[0]}")
    if not (root / _TOKENIZER_CONFIG).is_file():
        wrong.append(f"no {_TOKENIZER_CONFIG}")
    if not (root / _TOKENIZER).is_file() and not ((root / _VOCABULARY).is_file() and (root / _MERGES).is_file()):
        wrong.append(f"neither {_TOKENIZER} nor {_VOCABULARY} with {_MERGES}")
    if not (root / CONFIG).is_file():
        wrong.append(f"no {CONFIG}")
    for path in sorted(root.glob("*.json")):
        try:
            if path.stat().st_size < _SMALLEST:
                raise InputError(f"{path.name} is empty")
            if path.name != _TOKENIZER:  # it is read for its words
                read_json(path, "configuration", _LARGEST)
        except InputError as error:
            wrong.append(str(error))
    return ROWS.judge(
        "vlm processor", root, wrong, "processor, tokenizer and configuration are there", "fetch the folder again"
    )


def _read_vocabulary(root: Path) -> dict[str, int] | None:
    """Ids by word, added ones too; None where there is no `tokenizer.json`."""
    path = root / _TOKENIZER
    if not path.is_file():
        return None
    content = read_json(path, "tokenizer", _LARGEST)
    try:
        words = {str(word): int(number) for word, number in content["model"]["vocab"].items()}
        return words | {str(added["content"]): int(added["id"]) for added in content["added_tokens"]}
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not a tokenizer with a vocabulary ({error!r})") from error
