"""A check of times says no more than it ruled out."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_toolkit.clips.verification.findings import Verdict
from olt_toolkit.clips.verification.ruled_out_shifts import COARSEST_PASSED, judge_ruled_out

SHIFTS = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)


def judge(*told):
    return judge_ruled_out("times", "clip", {shift: shift in told for shift in SHIFTS}, "images were taken", "too even")


@pytest.mark.parametrize(
    ("told", "verdict", "says"),
    [
        (SHIFTS, Verdict.PASSED, "images were taken neither earlier nor later by 0.1 to 1.0 s"),
        ((0.3, 0.5, 0.7, 1.0), Verdict.PASSED, "images were taken neither earlier nor later by 0.3 to 1.0 s"),
        ((1.0,), Verdict.NOT_COMPARED, "tells only that images were taken neither earlier nor later by 1.0 s,"),
        # A longer shift may be there.
        ((0.1, 0.2, 0.3), Verdict.NOT_COMPARED, "too even"),
        ((0.2, 0.7, 1.0), Verdict.NOT_COMPARED, "by 0.7 to 1.0 s"),
        ((), Verdict.NOT_COMPARED, "too even"),
    ],
)
def test_what_is_ruled_out_is_said(told, verdict, says):
    found = judge(*told)
    assert found.verdict is verdict and says in found.detail


@given(st.sets(st.sampled_from(SHIFTS)))
def test_a_check_passes_only_where_every_longer_shift_is_ruled_out(told):
    found = judge(*told)
    if found.verdict is Verdict.PASSED:
        assert found.measured <= COARSEST_PASSED
        assert {shift for shift in SHIFTS if shift >= found.measured} <= told
    else:
        assert not {shift for shift in SHIFTS if shift >= COARSEST_PASSED} <= told
