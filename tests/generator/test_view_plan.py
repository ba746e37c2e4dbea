"""The dependency graph of the paper, and what is left out."""

from itertools import combinations

import pytest

from olt_generator.errors import InputError
from olt_generator.views.view_plan import CONDITIONS, VIEW_ID, plan_views

FRONT, TELE = "camera_front_wide_120fov", "camera_front_tele_30fov"
LEFT, RIGHT = "camera_cross_left_120fov", "camera_cross_right_120fov"
REAR_LEFT, REAR_RIGHT = "camera_rear_left_70fov", "camera_rear_right_70fov"
REAR_TELE = "camera_rear_tele_30fov"


def test_the_policys_four_cameras_leave_the_rear_out():
    plan = plan_views([LEFT, FRONT, RIGHT, TELE])
    assert plan.needed == (FRONT, TELE, LEFT, RIGHT)
    assert plan.methods == {FRONT: "given", TELE: "cropped", LEFT: "synthesized", RIGHT: "synthesized"}
    assert set(plan.left_out) == {REAR_LEFT, REAR_RIGHT, REAR_TELE}
    assert all(plan.left_out.values())


def test_graph_of_the_paper():
    ids = {
        VIEW_ID[view]: {VIEW_ID[condition] for condition in conditions}
        for view, conditions in CONDITIONS.items()
        if view in VIEW_ID
    }
    assert ids == {0: set(), 1: {0}, 2: {0}, 3: {0, 1}, 4: {0, 2}, 5: {0, 3, 4}}


def test_rear_tele_needs_every_generated_view():
    assert plan_views([REAR_TELE]).needed == (FRONT, LEFT, RIGHT, REAR_LEFT, REAR_RIGHT, REAR_TELE)
    assert set(plan_views([REAR_TELE]).left_out) == {TELE}


def test_rear_left_leaves_the_right_side_out():
    assert plan_views([REAR_LEFT]).needed == (FRONT, LEFT, REAR_LEFT)


def test_every_plan_is_complete_ordered_and_no_larger_than_it_must_be():
    for wanted in (set(views) for size in range(1, 8) for views in combinations(CONDITIONS, size)):
        plan = plan_views(wanted)
        assert wanted <= set(plan.needed)
        assert set(plan.needed) | set(plan.left_out) == set(CONDITIONS)
        assert not set(plan.needed) & set(plan.left_out)
        for position, view in enumerate(plan.needed):
            assert set(plan.conditions[view]) <= set(plan.needed[:position])
            assert view in wanted or any(view in plan.conditions[other] for other in plan.needed)


def test_unknown_views_are_refused():
    with pytest.raises(InputError, match="camera_roof"):
        plan_views([FRONT, "camera_roof"])
    with pytest.raises(InputError, match="none asked for"):
        plan_views([])
