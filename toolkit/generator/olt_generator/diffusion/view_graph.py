"""Which views the learned engine makes, and which others each is conditioned on.

Paper, section Cross-View Memory Bank: G(1) = G(2) = {0}, G(3) = {0, 1}, G(4) = {0, 2}, G(5) = {0, 3, 4}. The ids are
the paper's and the released generator's, not the policies' camera indices (docs/formats/generator.md).
"""

from collections.abc import Collection
from dataclasses import dataclass

from olt_generator.errors import InputError
from olt_generator.omissions import Omission

# Views by id: the index of the camera embedding. View 0 is given.
VIEWS: tuple[str, ...] = (
    "camera_front_wide_120fov",
    "camera_cross_left_120fov",
    "camera_cross_right_120fov",
    "camera_rear_left_70fov",
    "camera_rear_right_70fov",
    "camera_rear_tele_30fov",
)
# Ids of the views that each view is conditioned on.
CONDITIONS: tuple[tuple[int, ...], ...] = ((), (0,), (0,), (0, 1), (0, 2), (0, 3, 4))
# Most views that one is conditioned on.
MOST_CONDITIONS = 3


@dataclass(frozen=True)
class GenerationOrder:
    """What is generated for the wanted views, and what is not.

    Attributes:
        views: ids to generate, each after all that it is conditioned on.
        helpers: those of them that nobody wanted: only others are conditioned on them.
        left_out: views that nothing needs.
    """

    views: tuple[int, ...]
    helpers: tuple[int, ...]
    left_out: tuple[Omission, ...]


def order_views(wanted: Collection[str], given: Collection[str] = VIEWS[:1]) -> GenerationOrder:
    """Plan the generation of wanted views by name; the order in which they are named makes no difference.

    Args:
        given: views that a camera recorded; they condition others and are not generated.

    Raises:
        InputError: a name is none of `VIEWS`, nothing is wanted, or the front view is not given.
    """
    unknown = sorted({*wanted, *given} - set(VIEWS))
    if unknown or not wanted:
        raise InputError(f"views: {', '.join(unknown) or 'none'} asked for; choose from {', '.join(VIEWS[1:])}")
    if VIEWS[0] not in given:
        raise InputError(f"views: {VIEWS[0]} is not given; all others are made from it")
    wanted_ids, given_ids = ({VIEWS.index(name) for name in names} for names in (wanted, given))
    needed = set(wanted_ids)
    # Conditions have lower ids, so one pass from the last view to the first finds all ancestors.
    for view in reversed(range(len(VIEWS))):
        if view in needed - given_ids:
            needed |= set(CONDITIONS[view])
    views = tuple(sorted(needed - given_ids))
    return GenerationOrder(
        views,
        tuple(view for view in views if view not in wanted_ids),
        tuple(
            Omission(VIEWS[view], "no wanted view depends on it")
            for view in range(len(VIEWS))
            if view not in needed | given_ids
        ),
    )
