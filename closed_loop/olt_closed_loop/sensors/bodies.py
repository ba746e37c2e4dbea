"""What road users and things on the road are made of: a few boxes each, by label, in shares of their own box."""

from dataclasses import dataclass

from olt_closed_loop.scenes.looks import Color
from olt_closed_loop.scenes.scene import Agent

Faces = tuple[str, str, str, str]
"""Surfaces (`sensors.surfaces`) of the front, rear, sides and top."""


@dataclass(frozen=True)
class Part:
    """A box of a body: its extent as shares of the body's (low and high corner, 0 ... 1), surfaces and colour.

    The shares run from the rear to the front, from the right to the left, and upwards; without a colour of its own a
    part has the body's.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    surfaces: Faces = ("plain", "plain", "plain", "plain")
    color: Color | None = None


_DARK: Color = (40.0, 40.0, 44.0)
_TROUSERS: Color = (48.0, 56.0, 84.0)
_GLOVE: Color = (245.0, 245.0, 240.0)
_WAND: Color = (255.0, 40.0, 30.0)
_WHOLE = Part((0, 0, 0), (1, 1, 1))
_WHEEL: Faces = ("plain", "plain", "wheel", "plain")


def _wheels(places: tuple[float, ...], size: float, height: float) -> tuple[Part, ...]:
    """Wheels at both sides, by the share of the length at which each begins; `size` along and `height` up, shares."""
    return tuple(
        Part((place, low, 0), (place + size, low + 0.12, height), ("plain", "plain", "tyre", "plain"), _DARK)
        for place in places
        for low in (0.0, 0.88)
    )


_PERSON = (
    Part((0.25, 0.17, 0), (0.75, 0.45, 0.48), color=_TROUSERS),
    Part((0.25, 0.55, 0), (0.75, 0.83, 0.48), color=_TROUSERS),
    Part((0.15, 0.15, 0.46), (0.85, 0.85, 0.84)),
    Part((0.3, 0, 0.42), (0.7, 0.13, 0.82)),
    Part((0.3, 0.87, 0.42), (0.7, 1, 0.82)),
    Part((0.25, 0.32, 0.86), (0.75, 0.68, 1), ("skin", "skin", "skin", "plain")),
)

BODIES: dict[str, tuple[Part, ...]] = {
    "automobile": (
        Part((0, 0, 0.08), (1, 1, 0.62), ("car_front", "car_rear", "car_side", "plain")),
        Part((0.18, 0.06, 0.62), (0.72, 0.94, 1), ("glass", "glass", "glass", "plain")),
    ),
    "heavy_truck": (
        Part((0.78, 0.02, 0.1), (1, 0.98, 0.85), ("car_front", "plain", "glass", "plain")),
        Part((0, 0, 0.16), (0.76, 1, 1), ("plain", "car_rear", "panels", "plain")),
        *_wheels((0.04, 0.2, 0.84), 0.12, 0.3),
    ),
    "bus": (
        Part((0, 0, 0.1), (1, 1, 0.5), ("car_front", "car_rear", "plain", "plain")),
        Part((0, 0, 0.5), (1, 1, 0.88), ("glass", "glass", "windows", "plain")),
        Part((0, 0, 0.88), (1, 1, 1)),
        *_wheels((0.16, 0.74), 0.09, 0.3),
    ),
    "trailer": (
        Part((0, 0, 0.2), (0.9, 1, 1), ("plain", "car_rear", "panels", "plain")),
        Part((0.9, 0.45, 0.2), (1, 0.55, 0.3), color=_DARK),
        *_wheels((0.3, 0.5), 0.16, 0.32),
    ),
    "train_or_tram_car": (
        Part((0, 0, 0.06), (1, 1, 0.45), ("car_front", "car_rear", "plain", "plain")),
        Part((0, 0, 0.45), (1, 1, 0.85), ("glass", "glass", "windows", "plain")),
        Part((0, 0.02, 0.85), (1, 0.98, 1), color=_GLOVE),
    ),
    "other_vehicle": (
        Part((0.45, 0.28, 0.2), (1, 0.72, 0.62), ("car_front", "plain", "plain", "plain")),
        Part((0.08, 0.18, 0.35), (0.45, 0.82, 1), ("glass", "glass", "glass", "plain")),
        Part((0, 0, 0), (0.42, 0.24, 0.58), _WHEEL, _DARK),
        Part((0, 0.76, 0), (0.42, 1, 0.58), _WHEEL, _DARK),
        Part((0.72, 0.06, 0), (0.98, 0.24, 0.36), _WHEEL, _DARK),
        Part((0.72, 0.76, 0), (0.98, 0.94, 0.36), _WHEEL, _DARK),
    ),
    "rider": (
        Part((0, 0.42, 0), (0.38, 0.58, 0.38), ("plain", "plain", "spokes", "plain"), _DARK),
        Part((0.62, 0.42, 0), (1, 0.58, 0.38), ("plain", "plain", "spokes", "plain"), _DARK),
        Part((0.2, 0.46, 0.3), (0.8, 0.54, 0.36), color=_DARK),
        Part((0.36, 0.2, 0.14), (0.52, 0.4, 0.5), color=_TROUSERS),
        Part((0.36, 0.6, 0.2), (0.52, 0.8, 0.5), color=_TROUSERS),
        Part((0.3, 0.14, 0.48), (0.56, 0.86, 0.84)),
        Part((0.5, 0.06, 0.6), (0.78, 0.2, 0.68)),
        Part((0.5, 0.8, 0.6), (0.78, 0.94, 0.68)),
        Part((0.74, 0.1, 0.54), (0.78, 0.9, 0.6), color=_DARK),
        Part((0.4, 0.33, 0.85), (0.58, 0.67, 1), ("skin", "plain", "plain", "plain")),
    ),
    "person": _PERSON,
    "stroller": (
        Part((0.25, 0.1, 0.35), (0.95, 0.9, 0.75)),
        Part((0.1, 0.1, 0.7), (0.5, 0.9, 1), color=_DARK),
        *_wheels((0.2, 0.75), 0.22, 0.25),
    ),
    "animal": (
        Part((0.1, 0.15, 0.42), (0.8, 0.85, 0.74)),
        Part((0.74, 0.32, 0.66), (0.88, 0.68, 0.98)),
        Part((0.8, 0.28, 0.76), (1, 0.72, 0.94), color=(95.0, 68.0, 42.0)),
        Part((0.14, 0.18, 0), (0.22, 0.4, 0.44)),
        Part((0.14, 0.6, 0), (0.22, 0.82, 0.44)),
        Part((0.68, 0.18, 0), (0.76, 0.4, 0.44)),
        Part((0.68, 0.6, 0), (0.76, 0.82, 0.44)),
        Part((0.04, 0.42, 0.5), (0.1, 0.58, 0.72), color=_GLOVE),
    ),
    "cone": (
        Part((0, 0, 0), (1, 1, 0.06), color=_DARK),
        Part((0.2, 0.2, 0.06), (0.8, 0.8, 0.5), ("cone", "cone", "cone", "plain")),
        Part((0.34, 0.34, 0.5), (0.66, 0.66, 1), ("cone", "cone", "cone", "plain")),
    ),
    "barrier": (Part((0, 0, 0), (1, 1, 1), ("stripes", "stripes", "stripes", "plain")),),
    # Of those who direct traffic: an arm in a sleeve of high visibility, whose hand, at the left end of its box, wears
    # a white gauntlet and holds a lit wand upright; and signs whose face shows to both sides.
    "arm": (
        Part((0, 0, 0), (1, 0.6, 1)),
        Part((-0.15, 0.6, -0.15), (1.15, 1, 1.15), color=_GLOVE),
        Part((0.2, 0.82, 1.15), (0.8, 0.96, 4.4), ("wand", "wand", "wand", "plain"), _WAND),
    ),
    "sign_stop": (Part((0, 0, 0), (1, 1, 1), ("stop_face", "stop_face", "plain", "plain")),),
    "sign_go": (Part((0, 0, 0), (1, 1, 1), ("go_face", "go_face", "plain", "plain")),),
}


def parts_of(agent: Agent) -> tuple[Part, ...]:
    """The parts of an agent's body; one plain box for a label that is not in `BODIES`."""
    return BODIES.get(agent.label, (_WHOLE,))
