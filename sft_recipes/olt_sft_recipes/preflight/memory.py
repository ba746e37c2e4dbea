"""Bytes on each card of one training step, by part, from the sizes of the model and the settings of the stage.

Weights, gradients and optimizer states follow from counts and types: with DeepSpeed (ZeRO 1 to 3) weights are bf16 with
a float32 copy and two moments that the cards share (Rajbhandari et al., 2020, "ZeRO", section 5); without it the bf16
weights are trained themselves, with bf16 moments, as Stage 2 of the recipe does. Activations are those that the modules
of transformers keep for the backward pass with an attention that stores no score matrix (flash or SDPA).

What is assumed stands in `ASSUMED`; `tests/sft_recipes/preflight/test_memory.py` holds the rest against measured steps.
"""

from dataclasses import dataclass

from olt_sft_recipes.preflight.parameters import ModelSizes, TextShape, VisionShape
from olt_sft_recipes.preflight.plan import StagePlan

BF16, FLOAT32 = 2, 4
OPTIMIZER_BYTES = 3 * FLOAT32
"""A parameter of a DeepSpeed optimizer: float32 copy and two moments."""
_BUCKET = 200_000_000  # values: reduce_bucket_size and allgather_bucket_size of the recipe's zero2.json
_BUCKETS = 3  # one of allgather, and two of reduce for overlap_comm
_LIVE_PARAMETERS = 1_000_000_000  # stage3_max_live_parameters
ASSUMED = "2 GiB of CUDA context, kernels and libraries, and 10 % of the rest lost between blocks of the allocator"
_CONTEXT, _LOST = 2 << 30, 0.10

IMAGE_TOKENS = 180
PATCHES_PER_TOKEN = 4
TEXT_TOKENS = 150
"""Of system sentence, prompt and marks, around images and trajectory."""


@dataclass(frozen=True)
class SampleTokens:
    """Tokens of one sample: those of images, all others, and of these the labelled ones."""

    images: int
    others: int
    labelled: int = 131

    @property
    def total(self) -> int:
        """Length of the sequence."""
        return self.images + self.others


def sample_tokens(cameras: int, history: int, future: int, frames: int = 4) -> SampleTokens:
    """Tokens of a sample with 180 tokens an image, as the pixel limits of the releases make them."""
    return SampleTokens(cameras * frames * IMAGE_TOKENS, TEXT_TOKENS + history + future, future + 3)


def step_memory(sizes: ModelSizes, stage: StagePlan, tokens: SampleTokens, devices: int) -> dict[str, int]:
    """Bytes on one of so many devices at the peak of an optimizer step, by part."""
    trained = sum(sizes.trainable(stage).values())
    adapters = sizes.trainable(stage).get("adapters", 0)
    held = (sizes.total if stage.stage == 2 else sizes.language_model) + adapters
    parts = _state_bytes(held, trained, stage.zero_stage, devices)
    samples = stage.per_device_train_batch_size
    if stage.stage == 1:
        parts |= _first_stage_bytes(sizes, stage, tokens, samples)
    else:
        parts |= _second_stage_bytes(sizes, stage, tokens, samples)
    lost = round(_LOST * sum(parts.values()))
    return parts | {"context and gaps": _CONTEXT + lost}


def _state_bytes(held: int, trained: int, zero: int, devices: int) -> dict[str, int]:
    if zero == 0:
        # Parallel copies exchange gradients through buckets of the same size; one process has none.
        buckets = BF16 * trained if devices > 1 else 0
        return {
            "weights": BF16 * held,
            "gradients": BF16 * trained,
            "optimizer": 2 * BF16 * trained,
            "communication": buckets,
        }
    share = -(-trained // devices)
    weights = BF16 * held if zero < 3 else BF16 * (-(-held // devices) + min(held, _LIVE_PARAMETERS))
    return {
        "weights": weights,
        "gradients": BF16 * (trained if zero == 1 else share) + FLOAT32 * share,  # and their float32 copy for the step
        "optimizer": OPTIMIZER_BYTES * share,
        "communication": BF16 * _BUCKETS * min(_BUCKET, trained),
    }


def _first_stage_bytes(sizes: ModelSizes, stage: StagePlan, tokens: SampleTokens, samples: int) -> dict[str, int]:
    text, vision = sizes.text, sizes.vision
    length, patches = samples * tokens.total, samples * tokens.images * PATCHES_PER_TOKEN
    stacks = [
        (length * layer_bytes_per_token(text), BF16 * length * text.width, text.layers),
        (patches * block_bytes_per_patch(vision), BF16 * patches * vision.width, vision.blocks),
    ]
    logits = BF16 * length * text.vocabulary
    labelled = samples * tokens.labelled * text.vocabulary * 3 * FLOAT32
    # Logits, the copy that the loss makes of them, and their gradient.
    return {"activations": stack_bytes(stacks, stage.gradient_checkpointing), "logits": 3 * logits + 2 * labelled}


def _second_stage_bytes(sizes: ModelSizes, stage: StagePlan, tokens: SampleTokens, samples: int) -> dict[str, int]:
    """The language model keeps its cache alone; its logits and their loss are computed, without gradient."""
    text, expert = sizes.text, sizes.expert
    length, steps = samples * tokens.total, samples * 64
    cache = 2 * BF16 * length * text.key_width * text.layers
    kept = stack_bytes(
        [(steps * layer_bytes_per_token(expert), BF16 * steps * expert.width, expert.layers)],
        stage.gradient_checkpointing,
    )
    # Every layer of the expert joins the cached keys and values with its own, and keeps what it joined.
    joined = 2 * BF16 * (length + steps) * expert.key_width * expert.layers
    passing = length * (BF16 * 4 * text.width + 2 * BF16 * text.perceptron_width)
    logits = length * text.vocabulary * (BF16 + 2 * FLOAT32)
    return {"activations": cache + kept + joined, "logits": max(logits, passing)}


def stack_bytes(stacks: list[tuple[int, int, int]], checkpointed: bool) -> int:
    """Bytes kept by stacks of (bytes of a layer, bytes of its input, layers), of which one is recomputed at a time."""
    if not checkpointed:
        return sum(inner * layers for inner, _, layers in stacks)
    return sum(entry * layers for _, entry, layers in stacks) + max(inner for inner, *_ in stacks)


def layer_bytes_per_token(text: TextShape) -> int:
    """Bytes that one decoder layer keeps for a token in bf16.

    The norms compute in float32 and keep their input so, and their output before the scale; attention keeps queries,
    keys, values, its output and a float32 sum a head; the perceptron gate, its activation, the other branch and their
    product.
    """
    norm = FLOAT32 + BF16
    streams = 2 * (norm + BF16) * text.width
    heads = (norm + BF16) * (text.query_width + text.key_width)
    attention = BF16 * (text.key_width + text.query_width) + FLOAT32 * text.heads
    return streams + heads + attention + 4 * BF16 * text.perceptron_width


def block_bytes_per_patch(vision: VisionShape) -> int:
    """Bytes that one block of the image encoder keeps for a patch in bf16.

    Two norms keep input and output; attention keeps what its projection gave whole, turned queries and keys, and its
    output in two orders; the perceptron its inside before and after the activation.
    """
    return BF16 * (4 * vision.width + 3 * vision.width + 4 * vision.width + 2 * vision.perceptron_width)


def describe_bytes(parts: dict[str, int]) -> str:
    """The parts and their sum, in GiB."""
    told = " + ".join(f"{name} {size / 2**30:.1f}" for name, size in parts.items())
    return f"{sum(parts.values()) / 2**30:.1f} GiB = {told}"
