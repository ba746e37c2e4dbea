"""What is trained, held against the real class of transformers on the meta device, and published totals."""

from dataclasses import replace

import pytest

from olt_sft_recipes.launch.trainable import count_trained, model_sizes
from olt_sft_recipes.preflight.plan import recipe_stages

FIRST, SECOND = recipe_stages("alpamayo-r1")


def trained(stage):
    return {count.module: count.trained for count in count_trained(model_sizes(None), stage)}


def test_published_totals():
    # Qwen3-VL-8B has 8,767,123,696 parameters with its own vocabulary of 151,936; Alpamayo's has 155,697 rows.
    rows = 2 * 4096 * (155_697 - 151_936)
    assert sum(trained(FIRST).values()) == 8_767_123_696 + rows
    total = sum(count.parameters for count in count_trained(model_sizes(None), SECOND))
    assert 22e9 < 2 * total < 22.3e9  # the released folder: about 22 GB of bfloat16
    assert {module for module, count in trained(SECOND).items() if count} == {"action expert and projections"}


def test_adapters_that_do_not_freeze_the_rest_train_1_85_billion_beside_them():
    frozen = trained(replace(FIRST, lora_rank=16))
    assert sum(frozen.values()) == 43_646_976
    by_accident = trained(replace(FIRST, lora_rank=16, lora_freezes_rest=False))
    assert by_accident["token embedding"] + by_accident["output head"] == pytest.approx(1.28e9, rel=0.01)
    assert by_accident["image encoder"] == pytest.approx(576e6, rel=0.001)
    assert sum(by_accident.values()) - 43_646_976 == pytest.approx(1.85e9, rel=0.002)


@pytest.mark.slow
def test_modules_are_counted_as_transformers_builds_them():
    torch = pytest.importorskip("torch")
    transformers = pytest.importorskip("transformers")
    text = {
        "hidden_size": 4096,
        "intermediate_size": 12_288,
        "num_hidden_layers": 36,
        "num_key_value_heads": 8,
        "head_dim": 128,
    }
    text |= {"num_attention_heads": 32, "vocab_size": 155_697}
    vision = {"out_hidden_size": 4096}
    config = transformers.Qwen3VLConfig(text_config=text, vision_config=vision, tie_word_embeddings=False)
    with torch.device("meta"):
        model = transformers.Qwen3VLForConditionalGeneration(config)
    marks = {".visual.": "image encoder", "embed_tokens": "token embedding", "lm_head": "output head"}
    counted = dict.fromkeys([*marks.values(), "language layers"], 0)
    for name, parameter in model.named_parameters():
        counted[next((module for mark, module in marks.items() if mark in name), "language layers")] += (
            parameter.numel()
        )
    assert trained(FIRST) == counted
