"""How many items of each component every batch of an epoch holds.

Let components 1 to c have N_c items per epoch together, N in all. An epoch has K = N // B full batches of B items and
a last one of R = N % B. With p a permutation of 0 ... K - 1, components 1 to c together give

    floor(B N_c / N + p_k / K)    items to full batch k, and
    ceil(R N_c / N)               items to the last,

and a component gives the difference of two such numbers. It follows, for any counts and any p:

- a batch is filled exactly, because N_c / N ends at 1;
- a component gives its exact share of the batch rounded down or up, because floor(x + y) - floor(x) is floor(y) or
  ceil(y), and so for ceil: every batch is within one item of its share;
- over the full batches, components 1 to c give floor(K B N_c / N) by Hermite's identity, to which the last batch adds
  what is missing to N_c: the epoch holds every item that it should.

There is no state from batch to batch: any batch can be computed alone, in integers.
"""

import math
from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

GOLDEN_SECTION = (math.sqrt(5.0) - 1.0) / 2.0

Counts = NDArray[np.int64]


def batch_counts(counts: Sequence[int], batch_size: int) -> Counts:
    """Items of each component in each batch, (batches, components); the last batch may be partial.

    Each entry is the component's exact share of that batch rounded down or up; rows sum to the sizes of the batches
    and columns to `counts`, the items of each component in the epoch.
    """
    samples = sum(counts)
    full_batches, rest = divmod(samples, batch_size)
    # Ranks of the golden-section sequence: any stretch of them fills 0 ... full_batches - 1 evenly, so that running
    # totals stay close to their shares too.
    order = np.argsort(np.argsort(np.arange(full_batches) * GOLDEN_SECTION % 1.0))
    cumulative = np.zeros((full_batches + (rest > 0), len(counts) + 1), np.int64)
    for column, items in enumerate(accumulate(counts), start=1):
        whole, part = divmod(batch_size * items, samples)
        # part / samples + p_k / K reaches 1 from here on; both divisions are rounded up.
        threshold = -(-full_batches * (samples - part) // samples)
        cumulative[:full_batches, column] = whole + (order >= threshold)
        cumulative[full_batches:, column] = -(-rest * items // samples)
    return np.diff(cumulative, axis=1)
