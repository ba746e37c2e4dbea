"""Reference lines of OpenDRIVE roads and polynomials along them (ASAM OpenDRIVE 1.7, sections 7 and 9.)"""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from olt_closed_loop.scenes.sources.xml_files import child, number_of
from olt_generator.errors import InputError
from olt_generator.poses import Array

LONGEST_ROAD = 100_000.0
"""Metres of one road."""
_MOST_TURN = 8.0 * np.pi
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)  # exact to rounding for the turns of one geometry


@dataclass(frozen=True)
class Clothoid:
    """A line, arc or spiral: curvature runs linearly from `curvature` by `change` a metre."""

    curvature: float
    change: float

    def at(self, ds: Array) -> tuple[Array, Array, Array]:
        """Position u, v and heading (n,) at distances (n,) in the frame of the start."""
        along = 0.5 * ds[:, None] * (_NODES + 1.0)
        turned = along * (self.curvature + 0.5 * self.change * along)
        half = 0.5 * ds
        u, v = half * (np.cos(turned) @ _WEIGHTS), half * (np.sin(turned) @ _WEIGHTS)
        return u, v, ds * (self.curvature + 0.5 * self.change * ds)

    def curvature_at(self, ds: float) -> float:
        """1/m at a distance, positive to the left."""
        return self.curvature + self.change * ds


@dataclass(frozen=True)
class ParametricCubic:
    """`paramPoly3`: u and v are cubics in a parameter that is `scale` times the distance."""

    u: Array
    v: Array
    scale: float

    def at(self, ds: Array) -> tuple[Array, Array, Array]:
        """As `Clothoid.at`."""
        p = self.scale * ds
        powers = np.stack([np.ones_like(p), p, p**2, p**3], axis=-1)
        slopes = np.stack([np.zeros_like(p), np.ones_like(p), 2.0 * p, 3.0 * p**2], axis=-1)
        return powers @ self.u, powers @ self.v, np.arctan2(slopes @ self.v, slopes @ self.u)

    def curvature_at(self, ds: float) -> float:
        """As `Clothoid.curvature_at`."""
        p = self.scale * ds
        du, dv = (one[1] + p * (2.0 * one[2] + 3.0 * p * one[3]) for one in (self.u, self.v))
        bend_u, bend_v = (2.0 * one[2] + 6.0 * p * one[3] for one in (self.u, self.v))
        return float((du * bend_v - dv * bend_u) / max((du**2 + dv**2) ** 1.5, 1e-9))


@dataclass(frozen=True)
class Geometry:
    """A piece of a reference line that begins at station `s` and pose (x, y, heading)."""

    s: float
    x: float
    y: float
    heading: float
    shape: Clothoid | ParametricCubic


class ReferenceLine:
    """The reference line of a road: position and heading by station."""

    def __init__(self, pieces: Sequence[Geometry]) -> None:
        self._pieces = pieces
        self._starts = np.array([piece.s for piece in pieces])

    def curvature(self, s: float) -> float:
        """1/m at a station, positive to the left."""
        piece = self._pieces[max(0, int(np.searchsorted(self._starts, s, side="right")) - 1)]
        return piece.shape.curvature_at(s - piece.s)

    def at(self, s: Array) -> tuple[Array, Array]:
        """Positions (n, 2) and headings (n,) at stations (n,)."""
        positions, headings = np.zeros((len(s), 2)), np.zeros(len(s))
        index = np.clip(np.searchsorted(self._starts, s, side="right") - 1, 0, None)
        for number in np.unique(index):
            piece, here = self._pieces[number], index == number
            u, v, turned = piece.shape.at(s[here] - piece.s)
            cos, sin = np.cos(piece.heading), np.sin(piece.heading)
            positions[here] = np.column_stack([piece.x + cos * u - sin * v, piece.y + sin * u + cos * v])
            headings[here] = piece.heading + turned
        return positions, headings


class Cubics:
    """A piecewise cubic along a road: widths, offsets, heights; zero before its first piece."""

    def __init__(self, rows: Sequence[tuple[float, float, float, float, float]]) -> None:
        self._rows = np.array(sorted(rows), dtype=np.float64).reshape(-1, 5)

    def at(self, s: Array) -> Array:
        """Values (n,) at stations (n,)."""
        if len(self._rows) == 0:
            return np.zeros_like(s)
        index = np.searchsorted(self._rows[:, 0], s, side="right") - 1
        start, a, b, c, d = self._rows[np.clip(index, 0, None)].T
        ds = s - start
        return np.where(index < 0, 0.0, a + ds * (b + ds * (c + ds * d)))

    @property
    def level(self) -> bool:
        """Whether it is zero everywhere."""
        return not np.any(self._rows[:, 1:])


def read_reference_line(road: Element, length: float, where: str) -> ReferenceLine:
    """The reference line of a `<road>`.

    Raises:
        InputError: it has no pieces, they are not in order of their stations, or one is of a kind that is not read.
    """
    pieces = [_read_geometry(geometry, where) for geometry in child(road, "planView", where).findall("geometry")]
    stations = [piece.s for piece in pieces]
    if not stations or stations[0] > 0.01 or np.any(np.diff(stations) <= 0.0) or stations[-1] > length:
        raise InputError(f"{where}: planView has no pieces from s = 0 on in order of s, up to its length")
    return ReferenceLine(pieces)


def _read_geometry(element: Element, where: str) -> Geometry:
    s, x, y, heading, length = (number_of(element, name, where) for name in ("s", "x", "y", "hdg", "length"))
    if not 0.0 < length <= LONGEST_ROAD or s < 0.0:
        raise InputError(f"{where}: geometry at s = {s:g} of length {length:g}; more than 0 is expected")
    kinds = [kind for kind in element if kind.tag != "userData"]
    if len(kinds) != 1:
        raise InputError(f"{where}: geometry at s = {s:g} holds {len(kinds)} shapes; one is expected")
    (kind,) = kinds
    if kind.tag == "paramPoly3":
        u, v = (np.array([number_of(kind, f"{power}{axis}", where) for power in "abcd"]) for axis in "UV")
        normalized = kind.get("pRange", "normalized") == "normalized"
        return Geometry(s, x, y, heading, ParametricCubic(u, v, 1.0 / length if normalized else 1.0))
    if kind.tag == "line":
        first = last = 0.0
    elif kind.tag == "arc":
        first = last = number_of(kind, "curvature", where)
    elif kind.tag == "spiral":
        first, last = number_of(kind, "curvStart", where), number_of(kind, "curvEnd", where)
    else:
        raise InputError(f"{where}: geometry <{kind.tag:.40}> is not read; line, arc, spiral and paramPoly3 are")
    if max(abs(first), abs(last)) * length > _MOST_TURN:
        raise InputError(f"{where}: geometry at s = {s:g} turns more than four times round")
    return Geometry(s, x, y, heading, Clothoid(first, (last - first) / length))


def read_cubics(elements: Sequence[Element], start: str, where: str, offset: float = 0.0) -> Cubics:
    """The piecewise cubic of elements with attributes a, b, c, d, whose stations are called `start`, plus `offset`."""
    return Cubics(
        [
            (
                offset + number_of(element, start, where),
                number_of(element, "a", where),
                number_of(element, "b", where),
                number_of(element, "c", where),
                number_of(element, "d", where),
            )
            for element in elements
        ]
    )
