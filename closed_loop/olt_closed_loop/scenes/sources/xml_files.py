"""XML from outside: no entities, no document types, no network, and no more elements than a map has.

The parser is expat as Python ships it. A document type is refused as soon as it begins, so that there is no entity to
expand and nothing to fetch: what packages such as defusedxml do, in a few lines. Attributes are read strictly.
"""

import gc
import re
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from olt_closed_loop.scenes.sources.fields import FARTHEST
from olt_generator.errors import InputError
from olt_generator.files import read_bounded

MOST_BYTES = 64 << 20
MOST_ELEMENTS = 1_000_000
MOST_DEPTH = 64
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*")


def read_xml(path: Path, what: str, root: str) -> Element:
    """The root element of an XML file, which errors call `what`, such as "scenario".

    Raises:
        InputError: the file cannot be read, is larger than MOST_BYTES, is not well-formed, declares a document type
            (entities), is nested or long beyond any map, or its root is not called `root`.
    """
    return parse_xml(read_bounded(path, what, MOST_BYTES), str(path), what, root)


def parse_xml(content: bytes, where: str, what: str, root: str) -> Element:
    """The root element of an XML text, which errors call `where`; they are those of `read_xml`."""
    collecting = gc.isenabled()
    # A tree holds no cycles, and looking for some again and again takes three times as long as parsing.
    gc.disable()
    try:
        found = _parse(content)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise InputError(f"{where}: not readable as XML ({error}); give an unchanged copy") from error
    finally:
        if collecting:
            gc.enable()
    if found.tag != root:
        raise InputError(f"{where}: begins with <{found.tag:.40}>, and a {what} with <{root}>")
    return found


def _parse(content: bytes) -> Element:
    builder, parser = TreeBuilder(), expat.ParserCreate()
    depth = count = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > MOST_DEPTH or count > MOST_ELEMENTS:
            raise InputError(f"more than {MOST_ELEMENTS} elements, or nested deeper than {MOST_DEPTH}")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def refuse(*_: object) -> None:
        raise InputError("declares a document type (<!DOCTYPE>), whose entities are not expanded; remove it")

    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = refuse
    parser.Parse(content, True)
    return builder.close()


def root_tag(path: Path) -> str | None:
    """What the first element of a file is called, None where there is none in its first 64 KiB."""
    with path.open("rb") as file:
        head = file.read(1 << 16)
    found = re.search(rb"<([A-Za-z_][\w.-]*)", re.sub(rb"<!--.*?-->", b"", head, flags=re.DOTALL))
    return found[1].decode() if found else None


def child(element: Element, name: str, where: str) -> Element:
    """The first child of that name, an `InputError` if there is none."""
    found = element.find(name)
    if found is None:
        raise InputError(f"{where}: <{name}> is missing")
    return found


def text_of(element: Element, name: str, where: str) -> str:
    """An attribute, an `InputError` if it is missing."""
    value = element.get(name)
    if value is None:
        raise InputError(f"{where}: attribute {name} is missing")
    return value


def number_of(element: Element, name: str, where: str, missing: float | None = None) -> float:
    """An attribute as a finite number up to FARTHEST; `missing` where there is none.

    Raises:
        InputError: it is no such number, or there is none and `missing` is None.
    """
    if missing is not None and element.get(name) is None:
        return missing
    return parse_number(text_of(element, name, where), f"{where}: {name}")


def parse_number(text: str | None, where: str) -> float:
    """A finite number up to FARTHEST, an `InputError` if the text is none."""
    value = float(text) if text is not None and len(text) < 100 and _NUMBER.fullmatch(text) else np.nan
    if not abs(value) <= FARTHEST:
        raise InputError(f"{where} is {text!r:.40}, which is no finite number of that kind")
    return value
