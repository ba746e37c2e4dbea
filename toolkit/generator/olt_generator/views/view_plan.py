"""Which views are made, in which order, how, and what is left out.

Every view is made from the front view directly, so only the wanted ones are. (In the paper, generated views are
conditioned on one another; see docs/formats/generator.md.)
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

from olt_generator.errors import InputError
from olt_generator.omissions import Omission

Method = Literal["given", "cropped", "synthesized"]

# All views in the order in which they are made.
METHODS: dict[str, Method] = {
    "camera_front_wide_120fov": "given",
    "camera_front_tele_30fov": "cropped",
    "camera_cross_left_120fov": "synthesized",
    "camera_cross_right_120fov": "synthesized",
    "camera_rear_left_70fov": "synthesized",
    "camera_rear_right_70fov": "synthesized",
    "camera_rear_tele_30fov": "synthesized",
}


@dataclass(frozen=True)
class ViewPlan:
    """What to make and what not.

    Attributes:
        methods: how each wanted view comes about, in the order of making.
        left_out: the views that are not made.
    """

    methods: dict[str, Method]
    left_out: tuple[Omission, ...]

    @property
    def synthesizes(self) -> bool:
        """Whether any view is made from distance and motion."""
        return "synthesized" in self.methods.values()


def plan_views(wanted: Collection[str]) -> ViewPlan:
    """Plan the wanted views by name.

    Raises:
        InputError: a name is not one of the seven views, or nothing is wanted.
    """
    unknown = sorted(set(wanted) - set(METHODS))
    if unknown or not wanted:
        raise InputError(f"views: {', '.join(unknown) or 'none'} asked for; choose from {', '.join(METHODS)}")
    return ViewPlan(
        {view: method for view, method in METHODS.items() if view in wanted},
        tuple(Omission(view, "not wanted") for view in METHODS if view not in wanted),
    )
