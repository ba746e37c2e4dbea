"""Images of other cameras are found by their times."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from olt_datasets.sources.times import farthest_apart, nearest_images, starting_at
from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory

times = st.lists(st.integers(-(10**7), 10**7), min_size=1, max_size=30)


@given(times.map(lambda values: sorted(set(values))), times)
def test_the_nearest_is_found_and_of_two_the_earlier(stored, wanted):
    stored_us, wanted_us = np.array(stored, np.int64), np.array(wanted, np.int64)
    # `argmin` takes the first, which is the earlier.
    expected = np.abs(stored_us[:, None] - wanted_us).argmin(axis=0)
    np.testing.assert_array_equal(nearest_images(stored_us, wanted_us), expected)
    assert farthest_apart(stored_us, wanted_us) == np.abs(stored_us[expected] - wanted_us).max()


def test_motion_keeps_its_world():
    motion = Trajectory(np.array([0, 100_000, 200_000]), planar_pose([0.0, 1.0, 2.0], 5.0, 0.3))
    later = starting_at(motion, 100_000)
    assert later.timestamps_us.tolist() == [-100_000, 0, 100_000]
    np.testing.assert_array_equal(later.T_world_rig, motion.T_world_rig)
