from hypothesis import given
from hypothesis import strategies as st

from olt_generator.seeds import derive_seed, make_generator

KEYS = st.lists(st.integers() | st.text(max_size=8), min_size=1, max_size=4)


@given(KEYS, KEYS)
def test_equal_keys_and_only_they_give_equal_seeds(first, second):
    assert (derive_seed(*first) == derive_seed(*second)) == (first == second)


def test_a_number_and_its_text_differ():
    assert derive_seed(1) != derive_seed("1")


def test_seed_is_the_same_on_every_machine():
    # Pinned: a change here changes every result that was ever made with a seed.
    assert derive_seed("scene", "nominal", 3) == 6034616424510230622
    assert make_generator("scene", 0).integers(1 << 30) == make_generator("scene", 0).integers(1 << 30)
