import json
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_generator.errors import InputError
from olt_toolkit.runtime.json_files import parse_json, read_json


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": 1, "b": {"c": 1, "c": 2}}', "key 'c' is there twice in one object; remove one"),
        ("[" * 200_000, "not readable as JSON ("),
        ('{"a":' * 200_000, "not readable as JSON ("),
        ("9" * 5000, "not readable as JSON ("),
        ("{", "not readable as JSON ("),
        (b"\xff\xfe\xff", "not readable as JSON ("),
        ("", "not readable as JSON ("),
    ],
)
def test_what_a_parser_would_lose_or_choke_on_is_refused(text, message):
    with pytest.raises(InputError, match=re.escape(f"given: {message}")):
        parse_json(text, "given")


@given(st.recursive(st.none() | st.booleans() | st.integers() | st.text(), lambda inner: st.lists(inner), max_leaves=5))
def test_what_is_written_as_json_is_read_again(value):
    assert parse_json(json.dumps({"a": value}), "given") == {"a": value}


def test_the_size_is_bounded(tmp_path):
    (tmp_path / "a.json").write_text("[1, 2]")
    assert read_json(tmp_path / "a.json", "list", 6) == [1, 2]
    with pytest.raises(InputError, match="has 6 bytes; a list has at most 5"):
        read_json(tmp_path / "a.json", "list", 5)
    with pytest.raises(InputError, match="no such file"):
        read_json(tmp_path / "b.json", "list")
