"""The estimate of memory, held against real training steps of a tiny Qwen3-VL whose live bytes are counted."""

import weakref

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from olt_sft_recipes.preflight.memory import SampleTokens, block_bytes_per_patch, layer_bytes_per_token, step_memory
from olt_sft_recipes.preflight.parameters import (
    QWEN3_VL_8B,
    ModelSizes,
    TextShape,
    VisionShape,
    published_sizes,
)
from olt_sft_recipes.preflight.plan import StagePlan

transformers = pytest.importorskip("transformers")
pytestmark = pytest.mark.slow
IMAGE, LABELLED, SIDE = 999, 30, 20


class LiveBytes(TorchDispatchMode):
    """Counts the bytes of all tensors that operations make, while they live."""

    def __init__(self):
        super().__init__()
        self.sizes, self.now, self.peak = {}, 0, 0

    def count(self, tensor):
        storage = tensor.untyped_storage()
        key, size = storage._cdata, storage.nbytes()
        if key in self.sizes:
            return
        self.sizes[key] = size
        self.now += size
        self.peak = max(self.peak, self.now)
        weakref.finalize(storage, self._forget, key)

    def _forget(self, key):
        self.now -= self.sizes.pop(key)

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        out = function(*args, **(kwargs or {}))
        for leaf in tree_leaves(out):
            if isinstance(leaf, torch.Tensor):
                self.count(leaf)
        return out


def make_model(text, vision, device="cpu"):
    config = transformers.Qwen3VLConfig(
        text_config={
            "vocab_size": text.vocabulary,
            "hidden_size": text.width,
            "num_hidden_layers": text.layers,
            "num_attention_heads": text.heads,
            "num_key_value_heads": text.key_value_heads,
            "head_dim": text.head_width,
            "intermediate_size": text.perceptron_width,
            "rope_parameters": {
                "rope_type": "default",
                "rope_theta": 5e6,
                "mrope_section": [text.head_width // 2 - 2 * (text.head_width // 6), *2 * [text.head_width // 6]],
            },
        },
        vision_config={
            "depth": vision.blocks,
            "hidden_size": vision.width,
            "intermediate_size": vision.perceptron_width,
            "num_heads": 4,
            "out_hidden_size": text.width,
            "patch_size": 16,
            "spatial_merge_size": 2,
            "temporal_patch_size": 2,
            "num_position_embeddings": vision.positions,
            "deepstack_visual_indexes": list(range(vision.mergers_of_depth)),
        },
        image_token_id=IMAGE,
        video_token_id=IMAGE - 1,
        vision_start_token_id=IMAGE - 2,
        vision_end_token_id=IMAGE - 3,
    )
    with torch.device(device):
        return transformers.Qwen3VLForConditionalGeneration(config)


def sizes_of(model, text, vision):
    counts = {"visual": sum(tensor.numel() for tensor in model.model.visual.parameters())}
    counts |= dict.fromkeys(("embedding", "head"), text.vocabulary * text.width)
    counts["layers"] = sum(tensor.numel() for tensor in model.parameters()) - sum(counts.values())
    return ModelSizes(counts | {"expert": 0}, text, text, vision, "a tiny model")


def test_parameters_are_those_of_the_real_class():
    model = make_model(QWEN3_VL_8B, VisionShape(), "meta")
    real = sizes_of(model, QWEN3_VL_8B, VisionShape()).parameters
    assert {name: count for name, count in published_sizes().parameters.items() if name != "expert"} == {
        name: count for name, count in real.items() if name != "expert"
    }


def measure_step(model, text_tokens, images):
    """Peak bytes of the second optimizer step, with the loss as the recipe computes it: two means of few logits."""
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-4)
    per_image = SIDE * SIDE // 4
    words = torch.randint(0, 900, (text_tokens,)).tolist()
    ids = [each for number in range(images) for each in (*[IMAGE] * per_image, words[number])] + words[images:]
    ids = torch.tensor([ids])
    pixels = torch.randn(images * SIDE * SIDE, 3 * 2 * 16 * 16).to(torch.bfloat16)
    labelled = torch.zeros_like(ids, dtype=torch.bool)
    labelled[:, -LABELLED:] = True
    live = LiveBytes()
    for tensor in model.parameters():
        live.count(tensor)
    for _ in range(2):
        live.peak = 0
        with live:
            logits = model(
                input_ids=ids,
                pixel_values=pixels,
                image_grid_thw=torch.tensor([[1, SIDE, SIDE]] * images),
                mm_token_type_ids=(ids == IMAGE).long(),
                use_cache=False,
            ).logits
            loss = torch.zeros(())
            for _ in range(2):
                shifted = logits[..., :-1, :].clone()
                shifted = shifted[labelled[:, 1:]].contiguous().float()
                loss = loss + torch.nn.functional.cross_entropy(shifted, ids[:, 1:][labelled[:, 1:]])
            del logits, shifted
            loss.backward()
            del loss
            optimizer.step()
            optimizer.zero_grad()
    return live.peak, SampleTokens(images * per_image, text_tokens, LABELLED)


@pytest.mark.parametrize(
    ("layers", "blocks", "images", "text_tokens", "checkpointed"),
    [(4, 2, 1, 400, False), (4, 2, 1, 400, True), (4, 4, 4, 200, True), (2, 2, 2, 800, True), (6, 2, 1, 800, False)],
)
def test_the_peak_of_a_step_is_within_a_sixth_of_what_is_counted(layers, blocks, images, text_tokens, checkpointed):
    torch.manual_seed(0)
    torch.set_num_threads(1)
    text = TextShape(256, layers, 4, 2, 64, 768, 1000)
    vision = VisionShape(64, blocks, 172, positions=256, mergers_of_depth=1)
    model = make_model(text, vision).to(torch.bfloat16).train()
    if checkpointed:
        model.gradient_checkpointing_enable({"use_reentrant": False})
    measured, tokens = measure_step(model, text_tokens, images)
    stage = StagePlan(1, gradient_checkpointing=checkpointed)
    parts = step_memory(sizes_of(model, text, vision), stage, tokens, devices=1)
    counted = sum(size for name, size in parts.items() if name != "context and gaps")
    assert 1 / 1.17 < counted / measured < 1.17


def kept_bytes(run, model):
    """Bytes of what `run` keeps for the backward pass, weights left out."""
    weights = {tensor.untyped_storage().data_ptr() for tensor in model.parameters()}
    kept = {}

    def pack(tensor):
        storage = tensor.untyped_storage()
        if storage.data_ptr() not in weights:
            kept[storage.data_ptr()] = tensor
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor):
        out = run()
    assert out is not None
    return sum(tensor.untyped_storage().nbytes() for tensor in kept.values())


@pytest.mark.parametrize(("width", "heads", "keys", "inner"), [(256, 4, 2, 768), (128, 8, 2, 512), (384, 2, 1, 384)])
def test_what_a_layer_keeps_is_counted_to_a_hundredth(width, heads, keys, inner):
    length, sizes = 200, []
    for layers in (2, 4):
        text = TextShape(width, layers, heads, keys, 64, inner, 1000)
        model = make_model(text, VisionShape(64, 1, 172, positions=256, mergers_of_depth=1)).to(torch.bfloat16)
        ids = torch.arange(length)[None]
        sizes.append(kept_bytes(lambda m=model, i=ids: m.model.language_model(input_ids=i).last_hidden_state, model))
    measured = (sizes[1] - sizes[0]) / 2 / length
    assert layer_bytes_per_token(text) == pytest.approx(measured, rel=0.01)


def test_what_a_block_of_the_image_encoder_keeps_is_counted_to_a_fiftieth():
    sizes = []
    for blocks in (2, 4):
        vision = VisionShape(64, blocks, 172, positions=256, mergers_of_depth=1)
        model = make_model(TextShape(256, 1, 4, 2, 64, 768, 1000), vision).to(torch.bfloat16)
        pixels = torch.randn(SIDE * SIDE, 3 * 2 * 16 * 16).to(torch.bfloat16)
        grid = torch.tensor([[1, SIDE, SIDE]])
        sizes.append(kept_bytes(lambda m=model, p=pixels, g=grid: m.model.visual(p, grid_thw=g), model))
    measured = (sizes[1] - sizes[0]) / 2 / SIDE**2
    assert block_bytes_per_patch(vision) == pytest.approx(measured, rel=0.02)
