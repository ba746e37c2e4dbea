"""Embeddings of prompts by a small text encoder of the kind that Wan has."""

import pytest
import torch
from safetensors.torch import load_file
from tokenizers import Tokenizer, models, pre_tokenizers, processors
from transformers import PreTrainedTokenizerFast, UMT5Config, UMT5EncoderModel

from olt_generator.diffusion.text_embeddings import embed_texts
from olt_generator.errors import InputError
from olt_toolkit.commands.generate_embed import embed

WORDS = ("<pad>", "</s>", "<unk>", "a", "car", "in", "rain")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wan")
    words = Tokenizer(models.WordLevel({word: number for number, word in enumerate(WORDS)}, unk_token="<unk>"))
    words.pre_tokenizer = pre_tokenizers.WhitespaceSplit()
    words.post_processor = processors.TemplateProcessing(single="$A </s>", special_tokens=[("</s>", 1)])
    tokenizer = PreTrainedTokenizerFast(tokenizer_object=words, pad_token="<pad>", eos_token="</s>", unk_token="<unk>")
    tokenizer.save_pretrained(folder / "tokenizer")
    torch.manual_seed(0)
    sizes = {"d_model": 16, "d_kv": 4, "d_ff": 32, "num_layers": 2, "num_heads": 4, "vocab_size": len(WORDS)}
    UMT5EncoderModel(UMT5Config(**sizes)).save_pretrained(folder / "text_encoder")
    return folder


def embed_padded(folder, text, tokens):
    """The reference: padded to its length, what is padding masked."""
    tokenizer = PreTrainedTokenizerFast.from_pretrained(folder / "tokenizer")
    given = tokenizer(text, padding="max_length", max_length=tokens, return_tensors="pt")
    encoder = UMT5EncoderModel.from_pretrained(folder / "text_encoder").eval()
    with torch.inference_mode():
        made = encoder(given.input_ids, given.attention_mask).last_hidden_state[0]
    return made * given.attention_mask[0, :, None]


def test_a_text_has_the_embeddings_that_it_has_beside_masked_padding(folder):
    made = embed_texts(folder, ["a car in rain", ""], 9, dtype=torch.float32)
    assert made.shape == (2, 9, 16)
    torch.testing.assert_close(made[0], embed_padded(folder, "a car in rain", 9), atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(made[1], embed_padded(folder, "", 9), atol=1e-5, rtol=1e-5)
    assert made[0, :5].any() and not made[0, 5:].any()
    assert made[1, :1].any() and not made[1, 1:].any()


def test_white_space_does_not_count(folder):
    one, other = embed_texts(folder, ["a car in rain", "  a car\n in\train "], 9)
    assert torch.equal(one, other)


def test_a_text_that_is_too_long_is_refused_and_not_cut(folder):
    assert embed_texts(folder, ["a car"], 3).shape == (1, 3, 16)
    with pytest.raises(InputError, match="has 4 tokens; shorten it to 3"):
        embed_texts(folder, ["a car in"], 3)


def test_the_command_writes_what_training_takes(folder, tmp_path):
    out = tmp_path / "text.safetensors"
    embed("a car in rain", folder, out)
    written = load_file(out)
    assert written.keys() == {"prompt", "empty"} and written["prompt"].shape == written["empty"].shape == (256, 16)
    assert torch.equal(torch.stack([written["prompt"], written["empty"]]), embed_texts(folder, ["a car in rain", ""]))


def test_missing_files_and_an_empty_prompt_are_told(folder, tmp_path):
    out = tmp_path / "text.safetensors"
    with pytest.raises(InputError, match=r"text_encoder/config\.json is missing"):
        embed("a car", tmp_path, out)
    with pytest.raises(InputError, match="the prompt is empty"):
        embed("  ", folder, out)
    assert not out.exists()
