"""Only what is wanted is made; the rest is left out with a reason."""

from itertools import combinations

import pytest

from olt_generator.errors import InputError
from olt_generator.omissions import Omission
from olt_generator.views.view_plan import METHODS, plan_views

FRONT, TELE = "camera_front_wide_120fov", "camera_front_tele_30fov"
LEFT, RIGHT = "camera_cross_left_120fov", "camera_cross_right_120fov"
REAR_LEFT, REAR_RIGHT = "camera_rear_left_70fov", "camera_rear_right_70fov"
REAR_TELE = "camera_rear_tele_30fov"


def test_the_policys_four_cameras_leave_the_rear_out():
    plan = plan_views([LEFT, FRONT, RIGHT, TELE])
    assert plan.methods == {FRONT: "given", TELE: "cropped", LEFT: "synthesized", RIGHT: "synthesized"}
    assert plan.left_out == tuple(Omission(view, "not wanted") for view in (REAR_LEFT, REAR_RIGHT, REAR_TELE))
    assert plan.synthesizes


def test_a_rear_view_alone_costs_one_view():
    assert plan_views([REAR_TELE]).methods == {REAR_TELE: "synthesized"}


def test_crops_need_no_synthesis():
    assert not plan_views([TELE]).synthesizes
    assert not plan_views([TELE, FRONT]).synthesizes


def test_every_plan_is_complete_ordered_and_no_larger_than_it_must_be():
    for wanted in (set(views) for size in range(1, 8) for views in combinations(METHODS, size)):
        plan = plan_views(wanted)
        assert list(plan.methods) == [view for view in METHODS if view in wanted]
        assert {omission.what for omission in plan.left_out} == set(METHODS) - wanted


def test_unknown_views_are_refused():
    with pytest.raises(InputError, match="camera_roof"):
        plan_views([FRONT, "camera_roof"])
    with pytest.raises(InputError, match="none asked for"):
        plan_views([])
