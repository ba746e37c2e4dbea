"""What a recording cannot give is said before any work."""

from dataclasses import replace

import numpy as np
import pytest

from olt_generator.cameras import PinholeCamera
from olt_generator.errors import InputError
from olt_toolkit.clips.builder import build_clip
from olt_toolkit.clips.feasibility import why_no_sample
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, FRONT_TELE, FRONT_WIDE
from olt_toolkit.rigs.rig_files import pav_rig


def make_recording(field_of_view, count=5, step_us=100_000):
    return Recording(
        name="town",
        source="toy",
        frames=np.full((count, 54, 96, 3), 128, np.uint8),
        timestamps_us=step_us * np.arange(count, dtype=np.int64),
        camera=PinholeCamera.from_field_of_view(96, 54, np.radians(field_of_view)),
        T_rig_camera=pav_rig()[FRONT_WIDE].T_rig_camera,
        vehicle=DEFAULT_VEHICLE,
    )


def measure_nothing(*_):
    pytest.fail("the motion was measured")


def test_too_narrow_a_view_for_the_tele_crop_is_refused_before_the_motion_is_measured():
    options = BuildOptions(96, 54, poses=measure_nothing)
    with pytest.raises(InputError, match="tele view"):
        build_clip(make_recording(25.0), options)
    wide_alone = replace(options, cameras=(FRONT_WIDE,))
    with pytest.raises(pytest.fail.Exception, match="the motion was measured"):
        build_clip(make_recording(25.0), wide_alone)
    with pytest.raises(pytest.fail.Exception, match="the motion was measured"):
        build_clip(make_recording(60.0), replace(options, cameras=(FRONT_WIDE, FRONT_TELE)))


def test_true_views_that_are_not_there_are_refused_first():
    with pytest.raises(InputError, match="no true images of camera_cross_left_120fov"):
        build_clip(make_recording(60.0), BuildOptions(96, 54, use_reference_views=True))


def test_what_is_too_short_for_a_sample_is_known_from_its_times():
    assert "6.4 s of future" in why_no_sample(make_recording(60.0))
    assert why_no_sample(make_recording(60.0, 100)) is None
