"""Which views must be made for the views that are wanted, in which order, and what can be left out.

Every generated view is conditioned on others, so the dependency graph decides the order (paper, section Extrapolative
Synthesis: G(1) = G(2) = {0}, G(3) = {0, 1}, G(4) = {0, 2}, G(5) = {0, 3, 4}).
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

from olt_generator.errors import InputError

Method = Literal["given", "cropped", "synthesized"]

# View ids of the generator; the policy numbers the same cameras differently (docs/formats/generator.md). The front-tele
# view has none: it is a crop of view 0.
VIEW_ID: dict[str, int] = {
    "camera_front_wide_120fov": 0,
    "camera_cross_left_120fov": 1,
    "camera_cross_right_120fov": 2,
    "camera_rear_left_70fov": 3,
    "camera_rear_right_70fov": 4,
    "camera_rear_tele_30fov": 5,
}
FRONT_WIDE = "camera_front_wide_120fov"
FRONT_TELE = "camera_front_tele_30fov"

_CONDITION_IDS: dict[int, tuple[int, ...]] = {0: (), 1: (0,), 2: (0,), 3: (0, 1), 4: (0, 2), 5: (0, 3, 4)}
_NAMES = {view_id: name for name, view_id in VIEW_ID.items()}

# Every view after all views that it is conditioned on.
CONDITIONS: dict[str, tuple[str, ...]] = {
    FRONT_WIDE: (),
    FRONT_TELE: (FRONT_WIDE,),
    **{_NAMES[view]: tuple(_NAMES[id_] for id_ in ids) for view, ids in _CONDITION_IDS.items() if view > 0},
}


@dataclass(frozen=True)
class ViewPlan:
    """What to make and what not.

    Attributes:
        needed: the wanted views and their ancestors, each after the views that it is conditioned on.
        methods: how each needed view comes about.
        conditions: the views that each needed view is made from.
        left_out: why each other view is not made.
    """

    needed: tuple[str, ...]
    methods: dict[str, Method]
    conditions: dict[str, tuple[str, ...]]
    left_out: dict[str, str]


def plan_views(wanted: Collection[str]) -> ViewPlan:
    """Plan the wanted views by name.

    Raises:
        InputError: a name is not one of the seven views, or nothing is wanted.
    """
    unknown = sorted(set(wanted) - set(CONDITIONS))
    if unknown or not wanted:
        raise InputError(f"views: {', '.join(unknown) or 'none'} asked for; choose from {', '.join(CONDITIONS)}")
    ancestors: set[str] = set()
    for view in wanted:
        ancestors |= _with_ancestors(view)
    needed = tuple(view for view in CONDITIONS if view in ancestors)
    return ViewPlan(
        needed=needed,
        methods={view: _method(view) for view in needed},
        conditions={view: CONDITIONS[view] for view in needed},
        left_out={
            view: "not wanted, and no wanted view is made from it" for view in CONDITIONS if view not in ancestors
        },
    )


def _with_ancestors(view: str) -> set[str]:
    return {view}.union(*(_with_ancestors(condition) for condition in CONDITIONS[view]))


def _method(view: str) -> Method:
    if view == FRONT_WIDE:
        return "given"
    return "cropped" if view == FRONT_TELE else "synthesized"
