"""Which samples of a pool are drawn: those of least priority, a number that belongs to each moment alone.

The priority of a sample is a hash of the moment that it shows (scene, start of the window, time t0), keyed by the seed
and by what the draw is for. Nothing else has a part in it:

- GT and Syn clips of one window have the same priorities, so that recipes which differ in the kind alone draw the same
  moments. (Where a component uses both kinds side by side, the kind is part of the hash.)
- A larger draw keeps the samples of a smaller one, and clips that are added to a table move no other clip.
- Neither the order of rows nor their division into tables matters, and a pool of any size is drawn from in one pass.

The hash is multilinear in 64-bit words, modulo 2^64, with odd keys (Dietzfelbinger 1996), and mixed by the finalizer of
SplitMix64 (Steele, Lea and Flood 2014).
"""

import math

import numpy as np
import polars as pl

from olt_datasets.mixtures.recipe import Component
from olt_generator.seeds import make_generator
from olt_toolkit.policy.sample import KEYFRAME_US

# The last 48 bytes of a scene's id count; those that end alike have ties, which is harmless.
SCENE_WORDS = 6
WORD_BYTES = 8
TIMES = pl.col("sample_t0_us")
PRIORITY = "priority"
TWO_TO_64 = 2**64


def sample_count(component: Component) -> pl.Expr:
    """Number of samples that a clip gives to a component."""
    limit = 1 if component.t0 == "keyframe" else component.samples_per_clip
    count = TIMES.list.len().cast(pl.Int64)
    return count if limit is None else count.clip(upper_bound=limit)


def sample_times(component: Component) -> pl.Expr:
    """The sample times (list) that a clip gives to a component; it has at least one."""
    if component.t0 == "keyframe":
        distances = TIMES.list.eval((pl.element() - KEYFRAME_US).abs())
        return pl.concat_list(TIMES.list.get(distances.list.arg_min()))
    limit, count = component.samples_per_clip, TIMES.list.len().cast(pl.Int64)
    if limit is None:
        return TIMES
    parts = pl.int_ranges(pl.when(count > limit).then(limit).otherwise(0))
    middles = (2 * parts + 1) * count // (2 * limit)
    return pl.when(count > limit).then(TIMES.list.gather(middles)).otherwise(TIMES)


def draw_samples(
    clips: pl.LazyFrame, component: Component, available: int, count: int, seed: int, columns: tuple[str, ...]
) -> pl.DataFrame:
    """Draw `count` of the `available` samples that clips give to a component, without repetition.

    The component tells which sample times to take, and its name keys the draw; its caps are not looked at.

    Returns:
        The columns, `clip_id` among them, `t0_us` (int64) and `PRIORITY` (uint64), in order of priority.
    """
    word = pl.col(PRIORITY) + pl.col("t0_us").cast(pl.UInt64)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        word = (word ^ (word // pl.lit(1 << shift, pl.UInt64))) * pl.lit(factor, pl.UInt64)
    word = word ^ (word // pl.lit(1 << 31, pl.UInt64))
    samples = (
        clips.filter(TIMES.list.len() > 0)
        .select(*columns, _key(component, seed).alias(PRIORITY), t0_us=sample_times(component))
        .explode("t0_us")
        .with_columns(word.alias(PRIORITY))
    )
    # Priorities are uniform, so that a bound which hardly exceeds the share that is asked for leaves few to sort.
    share = (count + 6.0 * math.sqrt(count) + 16.0) / max(available, 1)
    while True:
        bounded = share < 1.0
        least = pl.col(PRIORITY) < pl.lit(math.floor(share * TWO_TO_64), pl.UInt64) if bounded else pl.lit(True)
        drawn = samples.filter(least).collect(engine="streaming")
        if len(drawn) >= count or not bounded:
            return drawn.sort(PRIORITY, "clip_id", "t0_us", maintain_order=True).head(count)
        share *= 2.0


def _key(component: Component, seed: int) -> pl.Expr:
    """The part of a priority that the samples of a clip have in common."""
    scene = pl.col("scene_id").str.pad_start(SCENE_WORDS * WORD_BYTES).cast(pl.Binary)
    words = [
        scene.bin.slice(-WORD_BYTES * place, WORD_BYTES).bin.reinterpret(dtype=pl.UInt64)
        for place in range(SCENE_WORDS, 0, -1)
    ]
    words.append(pl.col("start_us").cast(pl.UInt64))
    if component.where.kind == "any" and component.prefer is None:
        words.append((pl.col("kind") == "Syn").cast(pl.UInt64))
    generator = make_generator("mixture samples", seed, component.name)
    factors = [int(word) | 1 for word in generator.integers(TWO_TO_64, size=len(words), dtype=np.uint64)]
    # Sums and products of 64-bit words wrap.
    return pl.sum_horizontal(word * pl.lit(factor, pl.UInt64) for word, factor in zip(words, factors, strict=True))
