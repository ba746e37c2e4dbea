"""Random generators that depend on what they are for, and on nothing else."""

import hashlib

import numpy as np


def derive_seed(*keys: int | str) -> int:
    """A 63-bit seed from any keys; the same keys give the same seed on every machine."""
    text = "\x1f".join(f"{type(key).__name__}:{key}" for key in keys)
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "little") >> 1


def make_generator(*keys: int | str) -> np.random.Generator:
    """A generator seeded by `derive_seed`, so that results do not depend on the order in which work is done."""
    return np.random.default_rng(derive_seed(*keys))
