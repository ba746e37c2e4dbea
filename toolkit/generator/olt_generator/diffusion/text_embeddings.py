"""Embeddings of a prompt, made once with the text encoder that comes with Wan2.1-VACE."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from olt_generator.distance.model_folder import check_model_folder, load_network
from olt_generator.errors import InputError

# Tokens that the released generator lets a text have (docs/formats/generator.md).
TEXT_TOKENS = 256


@torch.inference_mode()
def embed_texts(
    folder: Path,
    texts: Sequence[str],
    tokens: int = TEXT_TOKENS,
    device: str = "cpu",
    dtype: torch.dtype = torch.bfloat16,
) -> Tensor:
    """Embeddings (n, tokens, width), float32, of texts; zero after the last token of each, as Wan was trained.

    Args:
        folder: a folder of Wan2.1-VACE as diffusers writes it, with the subfolders `tokenizer` and `text_encoder`.
        texts: their runs of white space count as one space.
        tokens: how long the embeddings are.
        dtype: of the encoder's weights.

    Raises:
        InputError: transformers is not installed, files are missing or damaged, or a text has more tokens.
    """
    try:
        from transformers import AutoTokenizer, UMT5EncoderModel
    except ImportError as error:
        raise InputError("embeddings of texts need transformers; pip install 'olt-generator[learned]'") from error
    check_model_folder(folder, ["text_encoder/config.json", "tokenizer/tokenizer_config.json"])
    try:
        tokenizer: Any = AutoTokenizer.from_pretrained(folder / "tokenizer", local_files_only=True)
    except (OSError, ValueError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise InputError(f"{folder / 'tokenizer'}: cannot be loaded as a tokenizer ({reason})") from error
    numbers = [tokenizer(" ".join(text.split()))["input_ids"] for text in texts]
    for text, own in zip(texts, numbers, strict=True):
        if len(own) > tokens:
            raise InputError(f"{text!r:.60}: has {len(own)} tokens; shorten it to {tokens}")
    encoder = load_network(UMT5EncoderModel, folder / "text_encoder", device, torch_dtype=dtype)
    embeddings = torch.zeros(len(texts), tokens, encoder.config.d_model)
    # One at a time, so that no text is computed together with the padding of another.
    for row, own in enumerate(numbers):
        embeddings[row, : len(own)] = encoder(torch.tensor([own], device=device)).last_hidden_state[0].float().cpu()
    return embeddings
