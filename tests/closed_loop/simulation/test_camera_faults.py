"""Faults of cameras: what the policy is shown against what the cameras saw."""

import numpy as np
import pytest

from olt_closed_loop.scenes.conditions import CLEAR_DAY, Conditions, parse_conditions
from olt_closed_loop.simulation.camera_faults import CameraFault, FaultyCameras, parse_camera_fault
from olt_generator.errors import InputError
from olt_toolkit.rigs.rig import CAMERA_INDEX

CAMERAS = ("camera_cross_left_120fov", "camera_front_wide_120fov")
LEFT, FRONT = range(2)
TIMES_US = np.arange(40) * 100_000


def film() -> np.ndarray:
    """Pictures (40, 2, 3, 4, 5), all of them different."""
    return np.random.default_rng(0).integers(40, 180, (40, 2, 3, 4, 5)).astype(np.uint8)


def show(*faults: CameraFault, seed: int = 0) -> tuple[np.ndarray, dict[str, int]]:
    cameras = FaultyCameras(faults, CAMERAS, seed)
    shown = np.stack([cameras.show(images, int(time)) for images, time in zip(film(), TIMES_US, strict=True)])
    return shown, dict(cameras.affected)


def test_without_faults_pictures_are_what_cameras_see() -> None:
    assert np.array_equal(show()[0], film())


def test_late_pictures_are_those_of_before() -> None:
    shown, affected = show(CameraFault("late", CAMERAS[FRONT], 0.3))
    assert np.array_equal(shown[3:, FRONT], film()[:-3, FRONT])
    assert np.array_equal(shown[:, LEFT], film()[:, LEFT])
    # The first picture is the oldest that there is.
    assert np.array_equal(shown[:3, FRONT], film()[[0, 0, 0], FRONT]) and list(affected.values()) == [39]


def test_dropped_pictures_leave_the_last_one() -> None:
    shown, affected = show(CameraFault("dropped", None, 0.5))
    for camera in (LEFT, FRONT):
        last = film()[0, camera]
        for picture, true in zip(shown[:, camera], film()[:, camera], strict=True):
            last = true if np.array_equal(picture, true) else last
            assert np.array_equal(picture, last)
    # A share of 80 pictures that are drawn one by one.
    assert 25 <= affected["dropped=0.5"] <= 55


def test_a_frozen_camera_shows_one_picture_from_then_on() -> None:
    shown, _ = show(CameraFault("frozen", CAMERAS[LEFT], 1.0))
    assert np.array_equal(shown[:11], film()[:11])
    assert np.array_equal(shown[11:, LEFT], np.repeat(film()[10:11, LEFT], 29, axis=0))
    assert np.array_equal(shown[:, FRONT], film()[:, FRONT])


def test_swapped_cameras_show_each_others_pictures() -> None:
    shown, _ = show(CameraFault("swapped", CAMERAS[FRONT], other=CAMERAS[LEFT]))
    assert np.array_equal(shown, film()[:, ::-1])


def test_exposure_doubles_light_with_every_stop() -> None:
    shown, _ = show(CameraFault("exposure", None, -2.0))
    np.testing.assert_allclose(shown, film() / 2.0, atol=0.51)


def test_noise_is_as_strong_as_asked_for_at_mid_grey() -> None:
    cameras = FaultyCameras([CameraFault("noise", None, 10.0)], CAMERAS, 0)
    grey = np.full((2, 3, 60, 60), 128, np.uint8)
    assert cameras.show(grey, 0).std() == pytest.approx(10.0, rel=0.05)


def test_the_seed_decides() -> None:
    faults = (CameraFault("noise", None, 5.0), CameraFault("dropped", None, 0.3))
    first, again, other = show(*faults)[0], show(*faults)[0], show(*faults, seed=1)[0]
    assert np.array_equal(first, again) and not np.array_equal(first, other)


@pytest.mark.parametrize(
    "text", ["noise=8", "late:camera_front_wide_120fov=0.2", "frozen=3.5", "exposure=-1", "dropped:cross_left=0.1"]
)
def test_words_are_read_as_they_are_written(text: str) -> None:
    fault = parse_camera_fault(text, list(CAMERA_INDEX))
    assert parse_camera_fault(fault.words, list(CAMERA_INDEX)) == fault


@pytest.mark.parametrize(
    "text",
    (
        *("", "noise", "blur=3", "noise=x", "noise=nan", "noise=-1", "dropped=1.2", "late=0.05", "late:front=0.1"),
        *("swapped=front_wide", "swapped:front_wide=front_wide", "noise:=3", "late:nowhere=0.1"),
    ),
)
def test_what_is_no_fault_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="camera fault"):
        parse_camera_fault(text, list(CAMERA_INDEX))


def test_a_fault_of_a_camera_that_is_not_there_is_refused() -> None:
    with pytest.raises(InputError, match="not camera_rear_tele"):
        FaultyCameras([CameraFault("noise", "camera_rear_tele_30fov", 3.0)], CAMERAS, 0)


def test_weather_is_read() -> None:
    assert parse_conditions("day", "clear") == CLEAR_DAY
    assert parse_conditions("night", "rain:0.3") == Conditions("night", rain=0.3)
    assert parse_conditions("low_sun", "fog") == Conditions("low_sun", fog=0.5)
    assert parse_conditions("night", "rain:0.3").words == "night, rain 0.3"
    for weather in ("snow", "rain:2", "fog:x", "clear:1", ""):
        with pytest.raises(InputError):
            parse_conditions("day", weather)
