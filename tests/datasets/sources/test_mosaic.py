"""One view put together from several cameras."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_datasets.sources.mosaic import NOBODY, Mosaic, choose_cameras, coverage
from olt_generator.cameras import PinholeCamera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig, make_pose
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, FRONT_TELE, FRONT_WIDE, MountedCamera
from olt_toolkit.rigs.rig_files import load_rig, pav_rig

SMALL = (104, 58)
NUSCENES = load_rig("nuscenes")
angles = st.floats(-np.pi, np.pi)


def small(rig, name, size=SMALL):
    return rig.fitted(*size)[name]


def looking(yaw, position=(0.0, 0.0, 1.5), field_of_view=60.0, size=(160, 90)):
    lens = PinholeCamera.from_field_of_view(*size, np.radians(field_of_view))
    return MountedCamera(lens, camera_pose_in_rig(position, 0.0, 0.0, np.radians(yaw)))


@pytest.mark.parametrize("source", ["nuscenes", "pandaset"])
@pytest.mark.parametrize("name", [FRONT_WIDE, CROSS_LEFT, CROSS_RIGHT, FRONT_TELE])
def test_every_pixel_shows_its_direction(world, source, name):
    """The lenses of PandaSet are bent, those of nuScenes straight; the world is infinitely far, so seams are exact."""
    rig = load_rig(source)
    mosaic = Mosaic(small(pav_rig(), name), rig.cameras)
    view = mosaic.compose({camera: world.picture(rig[camera], shrink=8) for camera in mosaic.cameras})
    mistakes = world.mistakes(view, mosaic.target)
    assert np.percentile(mistakes[mosaic.observed], 99) <= 2
    assert view[~mosaic.observed].max(initial=0) == 0


def test_shares_of_the_real_rigs():
    """Yaw 23 to 141 of 6 to 126 degrees across, but only the narrow height of the cameras."""
    target = small(pav_rig(), CROSS_LEFT)
    assert Mosaic(target, load_rig("nuscenes").cameras).cameras == ("CAM_BACK_LEFT", "CAM_FRONT", "CAM_FRONT_LEFT")
    for name, share in {"nuscenes": 0.61, "pandaset": 0.80}.items():
        assert coverage(target, load_rig(name).cameras) == pytest.approx(share, abs=0.01)
        assert Mosaic(target, load_rig(name).cameras).coverage == pytest.approx(share, abs=0.01)


def test_the_camera_that_looks_there_is_taken():
    """Between two cameras at 0 and 40 degrees the seam is at 20; both see 10 to 30."""
    chosen = choose_cameras(looking(20.0, field_of_view=90.0), {"ahead": looking(0.0), "left": looking(40.0)})
    middle = chosen[45]
    assert sorted(set(chosen.ravel().tolist())) == [NOBODY, 0, 1]
    columns = np.flatnonzero(np.diff(middle)) + 1
    assert 80 in columns
    assert (middle[75], middle[85]) == (1, 0)


def test_of_equals_the_first_by_name_is_taken():
    twins = {"b": looking(0.0), "a": looking(0.0)}
    assert set(choose_cameras(looking(0.0, field_of_view=30.0), twins).ravel()) == {0}
    assert Mosaic(looking(0.0, field_of_view=30.0), twins).cameras == ("a",)


@settings(max_examples=40)
@given(angles, angles, angles, st.floats(20.0, 120.0))
def test_the_nearest_axis_wins_and_the_coarse_share_is_the_share(yaw, pitch, roll, field_of_view):
    turn = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    lens = PinholeCamera.from_field_of_view(*SMALL, np.radians(field_of_view))
    target = MountedCamera(lens, make_pose(turn, [0.3, 0.2, 1.0]))
    rig = NUSCENES
    chosen = choose_cameras(target, rig.cameras)
    rays = pixel_rays(lens) @ turn.T
    names = sorted(rig.cameras)
    axes = np.stack([rig[name].T_rig_camera[:3, 2] for name in names])
    seen = np.stack([rig[name].camera.project(rays @ rig[name].T_rig_camera[:3, :3])[1] for name in names], -1)
    np.testing.assert_array_equal(chosen != NOBODY, seen.any(axis=-1))
    cosines = np.where(seen, rays @ axes.T, -np.inf)
    rows = np.nonzero(chosen != NOBODY)
    np.testing.assert_allclose(cosines[(*rows, chosen[rows])], cosines[rows].max(axis=-1), atol=1e-12)
    assert coverage(target, rig.cameras) == pytest.approx(float((chosen != NOBODY).mean()), abs=0.03)


def test_a_single_column_is_enough(world):
    """The last column of the view lies 29.9 degrees from the camera's axis, the one before it beyond its 30."""
    target, source = looking(59.7), looking(0.0)
    mosaic = Mosaic(target, {"ahead": source})
    assert np.flatnonzero(mosaic.observed.any(axis=0)).tolist() == [159]
    view = mosaic.compose({"ahead": world.picture(source)})
    assert world.mistakes(view, target)[mosaic.observed].max() <= 3


def test_nobody_looks_there(world):
    behind = Mosaic(looking(180.0), {"ahead": looking(0.0)})
    assert behind.cameras == ()
    assert behind.coverage == 0.0
    assert behind.compose({}).max() == 0
    assert coverage(looking(0.0), {}) == 0.0


def test_images_of_another_size_are_refused(world):
    with pytest.raises(InputError, match="give the camera at their size"):
        Mosaic(looking(0.0), {"ahead": looking(0.0)}).compose({"ahead": np.zeros((10, 10, 3), np.uint8)})
