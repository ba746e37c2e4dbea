import os
import re

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from olt_generator.errors import InputError
from olt_toolkit.runtime.yaml_files import MOST_DEPTH, parse_yaml, read_yaml_mapping


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2\na: 3", "line 3: key 'a' is there twice; remove one"),
        ("a: {b: 1, b: 1}", "line 1: key 'b' is there twice"),
        ("1: a\n1.0: b", "line 2: key 1.0 is there twice"),
        ("a:\n  - NO", "line 2: YAML takes NO for false; write 'NO', in quotes, or false"),
        ("a: On", "line 1: YAML takes On for true; write 'On', in quotes, or true"),
        ("a: 010", "line 1: YAML takes 010 for 8; write '010', in quotes, or 8"),
        ("a: 1:30", "line 1: YAML takes 1:30 for 90"),
        ("a: 2024-01-01", "line 1: 2024-01-01 is not YAML for a text but for a date"),
        ("a: 99999999999999999999", "line 1: 99999999999999999999 is beyond 9223372036854775807"),
        ("a: " + "9" * 5000, "line 1: 9999"),
        ('a: "x\\0"', "line 1: the text 'x\\x00' holds the control character '\\x00'"),
        ("[" * 20_000, f"line 1: is nested more than {MOST_DEPTH} deep"),
        ("{a: " * 20_000, f"line 1: is nested more than {MOST_DEPTH} deep"),
        ("- " * 20_000, f"line 1: is nested more than {MOST_DEPTH} deep"),
        ("a: &a [*a]", "line 1: *a holds itself"),
        ("a: &a {b: [*a]}", "line 1: *a holds itself"),
        ("a: !!binary aa", "line 1: the tag 'tag:yaml.org,2002:binary' is not YAML that is read"),
        ("a: !!python/object:os.system x", "line 1: the tag"),
        ("? [a]\n: b", "line 1: a key must be a text or a number"),
        ("a: [b", "not YAML (while parsing a flow sequence"),
        ("a: *b", "not YAML (found undefined alias"),
        ("a: =", "not YAML (could not determine"),
        ("<<: 1", "not YAML (while constructing a mapping"),
        ("a\n---\nb", "not YAML (expected a single document"),
    ],
)
def test_what_yaml_would_lose_guess_or_blow_up_is_refused(text, message):
    with pytest.raises(InputError, match=re.escape(f"given: {message}")) as error:
        parse_yaml(text, "given")
    assert "\n" not in str(error.value)


def test_aliases_that_multiply_are_refused_before_they_do():
    lines = ["a: &a [x, x, x, x, x, x, x, x, x]"]
    lines += [f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]" for old, new in zip("abcdefgh", "bcdefghi", strict=True)]
    with pytest.raises(InputError, match="values, with its aliases written out"):
        parse_yaml("\n".join(lines), "given")


def test_plain_values_anchors_and_merges_are_read():
    text = "a: &a {b: 1, c: [1.5, true, null, word, 'NO', 1_000, 0x10]}\nd: *a\ne: {<<: *a, b: 2}"
    read = parse_yaml(text, "given")
    assert read == yaml.safe_load(text)
    assert read["e"] == {"b": 2, "c": [1.5, True, None, "word", "NO", 1000, 16]}


texts = st.text(st.characters(blacklist_categories=("Cs", "Cc")), max_size=8)
values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=8,
)


@given(values)
def test_what_is_written_as_yaml_is_read_again(value):
    assert parse_yaml(yaml.safe_dump(value, allow_unicode=True), "given") == value


@given(st.text(max_size=40))
def test_any_text_is_read_or_refused(text):
    try:
        parse_yaml(text, "given")
    except InputError as error:
        assert str(error).startswith("given: ") and len(str(error).splitlines()) == 1


def test_only_regular_files_of_some_size_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(InputError, match="cannot read this rig: not a regular file"):
        read_yaml_mapping(tmp_path / "pipe.yaml", "rig", ["name"])
    (tmp_path / "large.yaml").write_text("#" * (5 << 20))
    with pytest.raises(InputError, match="a rig has at most"):
        read_yaml_mapping(tmp_path / "large.yaml", "rig", ["name"])
    (tmp_path / "latin.yaml").write_bytes(b"name: \xe4")
    with pytest.raises(InputError, match="cannot read this rig"):
        read_yaml_mapping(tmp_path / "latin.yaml", "rig", ["name"])
