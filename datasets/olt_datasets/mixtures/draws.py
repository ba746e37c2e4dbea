"""Which samples of a pool are drawn: those of least priority, a number that belongs to each moment alone.

The priority of a sample is a hash of the moment that it shows (scene, start of the window, time t0), keyed by the seed
and by what the draw is for. Nothing else has a part in it:

- GT and Syn clips of one window have the same priorities, so that recipes which differ in the kind alone draw the same
  moments. (Where a component uses both kinds side by side, the kind is part of the hash.)
- Where a component weighs its samples, the priority is divided by the weight: then twins are drawn alike where their
  weights are the same, and more often than not where they are not.
- A larger draw keeps the samples of a smaller one, and clips that are added to a table move no other clip.
- Neither the order of rows nor their division into tables matters, and a pool of any size is drawn from in one pass.

The hash is multilinear in 64-bit words, modulo 2^64, with odd keys (Dietzfelbinger 1996), and mixed by the finalizer of
SplitMix64 (Steele, Lea and Flood 2014).
"""

import math

import numpy as np
import polars as pl

from olt_datasets.mixtures.quality import ERRORS, TIMES, halvings, usable_places
from olt_datasets.mixtures.recipe import Component
from olt_generator.seeds import make_generator
from olt_toolkit.policy.sample import KEYFRAME_US

# The last 48 bytes of a scene's id count; those that end alike have ties, which is harmless.
SCENE_WORDS = 6
WORD_BYTES = 8
PRIORITY = "priority"
TWO_TO_64 = 2**64
# Steps of weighted priorities, which are logarithms, by which a draw finds its bound.
_BINS_A_UNIT = 16.0


def sample_count(component: Component) -> pl.Expr:
    """Number of samples that a clip gives to a component."""
    limit = 1 if component.t0 == "keyframe" else component.samples_per_clip
    count = usable_places(component.where).list.len().cast(pl.Int64)
    return count if limit is None else count.clip(upper_bound=limit)


def sample_lists(component: Component) -> tuple[pl.Expr, pl.Expr]:
    """Of the samples that a clip gives to a component: times (list), and action errors (list, NaN: not measured).

    The clip gives at least one sample.
    """
    errors = ERRORS.fill_null(TIMES.list.eval(pl.element().cast(pl.Float64) * math.nan))
    if component.t0 == "every" and component.samples_per_clip is None and component.where.action_error_max is None:
        return TIMES, errors
    places = _sample_places(component)
    return TIMES.list.gather(places), errors.list.gather(places)


def _sample_places(component: Component) -> pl.Expr:
    """Places (list) in its sample times of those that a clip gives to a component."""
    usable = usable_places(component.where)
    if component.t0 == "keyframe":
        distances = TIMES.list.gather(usable).list.eval((pl.element() - KEYFRAME_US).abs())
        return pl.concat_list(usable.list.get(distances.list.arg_min()))
    limit, count = component.samples_per_clip, usable.list.len().cast(pl.Int64)
    if limit is None:
        return usable
    parts = pl.int_ranges(pl.when(count > limit).then(limit).otherwise(0))
    middles = (2 * parts + 1) * count // (2 * limit)
    return pl.when(count > limit).then(usable.list.gather(middles)).otherwise(usable)


def draw_samples(
    clips: pl.LazyFrame, component: Component, available: int, count: int, seed: int, columns: tuple[str, ...]
) -> pl.DataFrame:
    """Draw `count` of the `available` samples that clips give to a component, without repetition.

    The component tells which sample times to take, and its name keys the draw; its caps are not looked at.

    Returns:
        The columns, `clip_id` among them, `t0_us` (int64), `action_error` (float64, metres; null: not measured) and
        `PRIORITY` (uint64, float64 where the component weighs its samples), in order of priority.
    """
    times, errors = sample_lists(component)
    word = pl.col(PRIORITY) + pl.col("t0_us").cast(pl.UInt64)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        word = (word ^ (word // pl.lit(1 << shift, pl.UInt64))) * pl.lit(factor, pl.UInt64)
    word = word ^ (word // pl.lit(1 << 31, pl.UInt64))
    samples = (
        clips.filter(times.list.len() > 0)
        .select(*columns, _key(component, seed).alias(PRIORITY), t0_us=times, action_error=errors)
        .explode("t0_us", "action_error")
        .with_columns(word.alias(PRIORITY), pl.col("action_error").fill_nan(None))
    )
    if component.weight_by:
        return _draw_weighted(samples.with_columns(_weigh(component).alias(PRIORITY)), count)
    # Priorities are uniform, so that a bound which hardly exceeds the share that is asked for leaves few to sort.
    share = (count + 6.0 * math.sqrt(count) + 16.0) / max(available, 1)
    while True:
        bounded = share < 1.0
        least = pl.col(PRIORITY) < pl.lit(math.floor(share * TWO_TO_64), pl.UInt64) if bounded else pl.lit(True)
        drawn = samples.filter(least).collect(engine="streaming")
        if len(drawn) >= count or not bounded:
            return drawn.sort(PRIORITY, "clip_id", "t0_us", maintain_order=True).head(count)
        share *= 2.0


def _weigh(component: Component) -> pl.Expr:
    """Priorities (float64) by which samples are drawn in proportion to their weights, as long as there are any.

    The priority p of a sample is one number u = p / 2^64, evenly spread between 0 and 1, and so -ln(1 - u) / w is
    exponential with rate w: the least come first as if each were drawn in proportion to the weights of those that are
    left (Efraimidis and Spirakis 2006). Taken here is its logarithm, which no weight is too small for.
    """
    # 52 bits and a half are below 1 in float64 too.
    u = ((pl.col(PRIORITY) // pl.lit(1 << 12, pl.UInt64)).cast(pl.Float64) + 0.5) / 2.0**52
    return (-(-u).log1p()).log() + math.log(2.0) * halvings(component)


def _draw_weighted(samples: pl.LazyFrame, count: int) -> pl.DataFrame:
    """The `count` samples of least priority (float64), with those alone in memory that may be among them."""
    place = (pl.col(PRIORITY) * _BINS_A_UNIT).floor()
    bins = samples.group_by(place.alias("bin")).agg(pl.len()).sort("bin").collect(engine="streaming")
    reached = bins.filter(pl.col("len").cum_sum() >= count)["bin"]
    least = place <= reached[0] if len(reached) else pl.lit(True)
    drawn = samples.filter(least).collect(engine="streaming")
    return drawn.sort(PRIORITY, "clip_id", "t0_us", maintain_order=True).head(count)


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
