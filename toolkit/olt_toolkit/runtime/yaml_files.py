"""YAML written by users: what YAML would lose, guess or blow up is refused with its line.

Of YAML 1.1 only mappings, lists, texts, numbers, true, false and null are read. Anchors and merges may be used, within
bounds.
"""

import re
import unicodedata
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NoReturn

import yaml

from olt_generator.errors import InputError
from olt_generator.files import read_bounded

MOST_BYTES = 4 << 20
MOST_DEPTH = 32
# Nodes of the content once all aliases are written out.
MOST_NODES = 250_000

_LARGEST_INTEGER = 2**63 - 1
_LONGEST_NUMBER = 64
_OCTAL = re.compile(r"[-+]?0[0-9_]+")


def read_yaml_mapping(path: Path, what: str, keys: Iterable[str]) -> dict[Any, Any]:
    """Read a YAML file that holds a mapping; keys and values are left to the caller to check,
    and so is whether numbers are finite.

    Errors call the file `what`, such as "recipe", and name the `keys` that it may have.

    Raises:
        InputError: the file cannot be read, is not a mapping, or see `parse_yaml`.
    """
    try:
        text = read_bounded(path, what, MOST_BYTES).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot read this {what} ({error}); give a YAML file") from error
    content = parse_yaml(text, str(path))
    if not isinstance(content, dict):
        raise InputError(f"{path}: a {what} is a mapping with the keys {', '.join(keys)}")
    return content


def parse_yaml(text: str, where: str) -> Any:
    """The content of a YAML text, which errors call `where`.

    Raises:
        InputError: it is not YAML; a key comes twice; words are taken for something else, as NO for false, 010 for 8,
            1:30 for 90 and 2024-01-01 for a date; an integer needs more than 64 bits; a text holds control characters;
            or it is tagged, or nested or repeated beyond all use.
    """
    try:
        _check_size(text)
        return yaml.load(text, _Loader)  # noqa: S506
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"{where}: not YAML ({' '.join(str(error).split())})") from error


def _check_size(text: str) -> None:
    """Refuse what would take long to put together, from its events alone."""
    anchored: dict[str, int] = {}
    nodes, open_nodes = 0, []  # of each collection that is open: its anchor and how many nodes came before it
    for event in yaml.parse(text, _Loader):
        anchor, before = getattr(event, "anchor", None), nodes
        if getattr(event, "tag", None) is not None:
            raise _refuse(event, f"the tag {event.tag!r:.60} is not YAML that is read; write a plain value")
        if isinstance(event, yaml.AliasEvent):
            if any(anchor == outer for outer, _ in open_nodes):
                raise _refuse(event, f"*{anchor} holds itself")
            nodes += anchored.get(event.anchor, 0)
        elif isinstance(event, yaml.ScalarEvent):
            nodes += 1
        elif isinstance(event, yaml.CollectionStartEvent):
            nodes += 1
            open_nodes.append((anchor, before))
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = open_nodes.pop()
        else:
            continue
        if anchor is not None and not isinstance(event, yaml.AliasEvent | yaml.CollectionStartEvent):
            anchored[anchor] = nodes - before
        if len(open_nodes) > MOST_DEPTH:
            raise _refuse(event, f"is nested more than {MOST_DEPTH} deep")
        if nodes > MOST_NODES:
            raise _refuse(event, f"is more than {MOST_NODES} values, with its aliases written out")


def _refuse(place: yaml.Event | yaml.Node, problem: str) -> InputError:
    return InputError(f"line {place.start_mark.line + 1}: {problem}")


class _Loader(yaml.CSafeLoader):
    """Makes plain values alone."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            if not isinstance(key_node, yaml.ScalarNode):
                raise _refuse(key_node, "a key must be a text or a number")
            key = self.construct_object(key_node)
            if key in seen:
                raise _refuse(key_node, f"key {key!r} is there twice; remove one")
            seen.add(key)
        return super().construct_mapping(node, deep)

    def construct_text(self, node: yaml.ScalarNode) -> str:
        text = self.construct_yaml_str(node)
        wrong = next((each for each in text if unicodedata.category(each) in ("Cc", "Cs") and each not in "\n\t"), None)
        if wrong is not None:
            raise _refuse(node, f"the text {text!r:.60} holds the control character {wrong!r}; remove it")
        return text

    def construct_truth(self, node: yaml.ScalarNode) -> bool:
        truth = self.construct_yaml_bool(node)
        if node.value.lower() not in ("true", "false"):
            raise _mistaken(node, str(truth).lower())
        return truth

    def construct_integer(self, node: yaml.ScalarNode) -> int:
        value = self.construct_yaml_int(node) if len(node.value) <= _LONGEST_NUMBER else _LARGEST_INTEGER + 1
        if not -_LARGEST_INTEGER - 1 <= value <= _LARGEST_INTEGER:
            raise _refuse(node, f"{node.value:.60} is beyond {_LARGEST_INTEGER}, the largest number that is read")
        if ":" in node.value or _OCTAL.fullmatch(node.value):
            raise _mistaken(node, str(value))
        return value

    def construct_real(self, node: yaml.ScalarNode) -> float:
        value = self.construct_yaml_float(node)
        if ":" in node.value:
            raise _mistaken(node, str(value))
        return value

    def refuse_date(self, node: yaml.ScalarNode) -> NoReturn:
        raise _refuse(node, f"{node.value} is not YAML for a text but for a date; write '{node.value}', in quotes")


def _mistaken(node: yaml.Node, taken_for: str) -> InputError:
    return _refuse(node, f"YAML takes {node.value} for {taken_for}; write '{node.value}', in quotes, or {taken_for}")


for _kind, _construct in {
    "bool": _Loader.construct_truth,
    "int": _Loader.construct_integer,
    "float": _Loader.construct_real,
    "str": _Loader.construct_text,
    "timestamp": _Loader.refuse_date,
}.items():
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _construct)
