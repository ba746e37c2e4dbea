"""How well sources cover the scene factors of a target slice, and which shares of them come closest to it.

A source's coverage is how its clips divide among scene factors; a clip of several factors counts for each with an
equal part, so that a mixture of sources by clips divides as their coverages mixed by the same shares. The alignment
gap is the total variation between coverage and target,

    gap = 1/2 sum_k |p_k - t_k|,

the part of the clips that would have to be of another factor: 0 for the same distribution, 1 for none in common. It
makes the best shares a linear program.

Counts are small and some are zero, which does not show that a source has no such scene. The distributions behind them
are therefore taken from the Dirichlet posterior with one clip of prior, spread evenly over the factors (Perks 1947):
a gap is reported as the posterior's median with its central 95 % interval.

The paper's example: of temporary path reassignment NV has 671 clips and Waymo E2E 52, of human-guided traffic control
62 and none. For a target that divides as NV does, Waymo's gap is small only because the second factor is rare:

    >>> alignment = align_sources(PAPER_COVERAGE, PAPER_COVERAGE["nv"])
    >>> [source.name for source in alignment.sources], [round(source.share, 2) for source in alignment.sources]
    (['nv', 'waymo_e2e'], [0.99, 0.01])
    >>> print(word_missing_factor(alignment.missing[0]))
    waymo_e2e: none of its 52 clips has human_guided_control, 8.5 % of the target; 95 % sure that fewer than 5.6 % do
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import polars as pl
from scipy.optimize import linprog

from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_generator.seeds import make_generator

NO_FACTOR = "none"
"""What a clip without any factor counts for."""

PAPER_COVERAGE = {
    "nv": {"temporary_path_reassignment": 671.0, "human_guided_control": 62.0},
    "waymo_e2e": {"temporary_path_reassignment": 52.0, "human_guided_control": 0.0},
}
"""Clips of two patterns of complex intersections in NVIDIA's and Waymo's data (docs/formats/paper.md)."""

PRIOR_CLIPS = 1.0
DRAWS = 4000
CONFIDENCE = 0.95

Dimension = Literal["factors", "category", "country"]
Coverage = Mapping[str, float]


@dataclass(frozen=True)
class Gap:
    """An alignment gap, 0 to 1: the median of the posterior and its central 95 % interval."""

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class AlignedSource:
    """How one source stands to the target: the number of its clips, and its proposed share of them."""

    name: str
    clips: float
    gap: Gap
    share: float


@dataclass(frozen=True)
class MissingFactor:
    """A factor of the target that a source with so many clips has not once; None for these where no source has it.

    With the probability `CONFIDENCE`, less than the bound of all clips of the source are such.
    """

    factor: str
    target_share: float
    source: str | None = None
    clips: float | None = None
    bound: float | None = None


@dataclass(frozen=True)
class SourceAlignment:
    """How sources stand to a target slice: shares of its factors, clips of each source by factor, and gaps.

    The pooled gap is that of all clips of all sources together, the proposed one that of the proposed shares.
    """

    target: dict[str, float]
    coverage: dict[str, dict[str, float]]
    sources: tuple[AlignedSource, ...]
    pooled_gap: Gap
    proposed_gap: Gap
    missing: tuple[MissingFactor, ...]


def measure_coverage(clips: pl.DataFrame | pl.LazyFrame, by: Dimension = "factors") -> dict[str, dict[str, float]]:
    """Clips of each source by factor, category or country; a clip of several factors counts for each in part."""
    values = pl.col("factors") if by == "factors" else pl.concat_list(by)
    counted = (
        clips.lazy()
        .select("source", value=values, values=values.list.len().clip(lower_bound=1))
        .explode("value", empty_as_null=True, keep_nulls=True)
        .group_by("source", pl.col("value").fill_null(NO_FACTOR), "values")
        .len()
        .collect(engine="streaming")
    )
    coverage: dict[str, dict[str, float]] = {}
    for source, value, values_of_clip, count in sorted(counted.rows()):
        shares = coverage.setdefault(source, {})
        shares[value] = shares.get(value, 0.0) + count / values_of_clip
    return coverage


def align_sources(
    coverage: Mapping[str, Coverage],
    target: Coverage,
    target_is_sample: bool = False,
    samples: int | None = None,
    seed: int = 0,
) -> SourceAlignment:
    """Compare sources with a target, and propose shares that bring their mixture closest to it.

    Of all shares that are equally close, those nearest to the sources' own sizes are proposed.

    Args:
        coverage: clips of each source by factor.
        target: weights of the factors in the target.
        target_is_sample: the weights are counts of clips, and as uncertain as such.
        samples: number of clips to be taken, none twice: no source is given a share that it is too small for.

    Raises:
        InputError: there is no source or no target, or all sources together have fewer clips than `samples`.
    """
    if not coverage or not any(target.values()):
        raise InputError("alignment: no clip is left in the sources or in the target; change the filters")
    factors = sorted({factor for part in (target, *coverage.values()) for factor in part})
    counts = np.array([[part.get(factor, 0.0) for factor in factors] for part in coverage.values()])
    weights = np.array([target.get(factor, 0.0) for factor in factors])
    wanted = weights / weights.sum()
    sizes = counts.sum(axis=1)

    if samples is not None and sizes.sum() < samples:
        raise InputError(f"alignment: the sources have {sizes.sum():g} clips, {samples} are asked for; ask for fewer")
    limits = np.ones(len(sizes)) if samples is None else np.minimum(sizes / samples, 1.0)

    # Parameters of the Dirichlet posteriors.
    posteriors, posterior = (array + PRIOR_CLIPS / len(factors) for array in (counts, weights))
    aim = posterior / posterior.sum() if target_is_sample else wanted
    means = posteriors / posteriors.sum(axis=1, keepdims=True)
    shares = propose_shares(means, aim, sizes / sizes.sum(), limits)

    generator = make_generator("alignment", seed)
    drawn = np.stack([generator.dirichlet(row, DRAWS) for row in posteriors])
    aims = generator.dirichlet(posterior, DRAWS) if target_is_sample else wanted

    def gap_of(mixed: Array) -> Gap:
        tail = 50.0 * (1.0 - CONFIDENCE)
        gaps = total_variation(np.tensordot(mixed, drawn, axes=1), aims)
        low, median, high = np.percentile(gaps, [tail, 50.0, 100.0 - tail]).tolist()
        return Gap(median, low, high)

    own = [gap_of(alone) for alone in np.eye(len(sizes))]
    return SourceAlignment(
        target=dict(zip(factors, wanted.tolist(), strict=True)),
        coverage={
            name: dict(zip(factors, row, strict=True)) for name, row in zip(coverage, counts.tolist(), strict=True)
        },
        sources=tuple(map(AlignedSource, coverage, sizes.tolist(), own, shares.tolist())),
        pooled_gap=gap_of(sizes / sizes.sum()),
        proposed_gap=gap_of(shares),
        missing=tuple(_find_missing(list(coverage), counts, factors, wanted)),
    )


def total_variation(first: Array, second: Array) -> Array:
    """Total variation (...) of distributions (..., factors): the part of one that is not in the other."""
    return 0.5 * np.abs(first - second).sum(axis=-1)


def propose_shares(distributions: Array, target: Array, sizes: Array, limits: Array) -> Array:
    """The shares of sources whose mixture has the least total variation from the target.

    A linear program in the shares w and the absolute differences u; a second one chooses among its solutions.

    Args:
        distributions: (sources, factors), each row sums to 1, as the target (factors,) does.
        sizes: (sources,) shares to stay near to where there is a choice; they sum to 1, as what is returned does.
        limits: (sources,) the largest shares; they sum to at least 1.
    """
    first = _nearest([(distributions.T, target)], limits)
    least = float(total_variation(first @ distributions, target))
    shares = _nearest([(np.eye(len(sizes)), sizes), (distributions.T, target)], limits, least + 1e-9)
    shares = np.where(shares < 1e-6, 0.0, shares)
    return shares / shares.sum()


def _nearest(terms: Sequence[tuple[Array, Array]], limits: Array, budget: float | None = None) -> Array:
    """Shares w, each from 0 to its limit, that minimise sum |A w - b| / 2 of the first term (A, b).

    With a budget, that of the second term is kept to it.
    """
    # Unknowns are the shares and, for each row of A w - b, a bound of its absolute value.
    matrix = np.concatenate([rows for rows, _ in terms])
    aim = np.concatenate([goal for _, goal in terms])
    bounded = -np.eye(len(aim))
    above = np.block([[matrix, bounded], [-matrix, bounded]])
    cost, rest = np.zeros(len(limits) + len(aim)), np.zeros(len(limits) + len(aim))
    cost[len(limits) : len(limits) + len(terms[0][1])] = 0.5
    rest[len(limits) + len(terms[0][1]) :] = 0.5
    sum_to_one = np.arange(len(cost)) < len(limits)
    found = linprog(
        cost,
        A_ub=above if budget is None else np.vstack([above, rest]),
        b_ub=np.concatenate([aim, -aim, [] if budget is None else [budget]]),
        A_eq=sum_to_one[None].astype(float),
        b_eq=[1.0],
        bounds=[(0.0, float(limit)) for limit in limits] + [(0.0, None)] * len(aim),
    )
    if not found.success:
        raise RuntimeError(f"the linear program of shares was not solved: {found.message}")
    return found.x[: len(limits)]


def word_missing_factor(missing: MissingFactor) -> str:
    """One line for people."""
    wanted = f"{missing.factor}, {100.0 * missing.target_share:.1f} % of the target"
    if missing.source is None or missing.bound is None:
        return f"no source has {wanted}: no shares of them close this part of the gap"
    return (
        f"{missing.source}: none of its {missing.clips:g} clips has {wanted}; {100.0 * CONFIDENCE:g} % sure that fewer "
        f"than {100.0 * missing.bound:.1f} % do"
    )


def _find_missing(
    names: Sequence[str], counts: Array, factors: Sequence[str], target: Array
) -> Iterator[MissingFactor]:
    for factor, share, column in zip(factors, target.tolist(), counts.T, strict=True):
        if share and not column.any():
            yield MissingFactor(factor, share)
        elif share:
            for row in np.flatnonzero(column == 0.0).tolist():
                clips = counts[row].sum()
                # Zero of n are seen with 5 % probability where this part of all clips has the factor.
                bound = 1.0 - (1.0 - CONFIDENCE) ** (1.0 / clips)
                yield MissingFactor(factor, share, names[row], float(clips), float(bound))
