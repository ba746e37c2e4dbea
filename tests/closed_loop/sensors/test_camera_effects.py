"""Shutter, windscreen, imager and encoder: each against what it stands for."""

from dataclasses import replace

import numpy as np
import pytest

from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.sensors.camera_effects import NO_EFFECTS, CameraEffects, Film
from olt_closed_loop.sensors.camera_rays import strip_rows
from olt_closed_loop.sensors.compression import compress
from olt_closed_loop.sensors.imager import Imager
from olt_closed_loop.sensors.ray_casting import SceneRenderer
from olt_closed_loop.sensors.recorder import record_drive
from olt_closed_loop.sensors.shutter import Shutter, expose
from olt_closed_loop.sensors.windscreen import Windscreen, WindscreenGlass
from olt_generator.cameras import PinholeCamera
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import CROSS_LEFT, FRONT_WIDE, MountedCamera

MOUNTED = MountedCamera(
    PinholeCamera.from_field_of_view(160, 96, np.radians(70.0)), camera_pose_in_rig([1.5, 0.0, 1.5], 0.0, 0.05, 0.0)
)
TIME = 3_000_000


@pytest.fixture(scope="module")
def scene() -> Scene:
    return replace(generate_scene("nominal", 3), agents=())


@pytest.fixture(scope="module")
def renderer(scene: Scene) -> SceneRenderer:
    return SceneRenderer(scene)


@pytest.fixture(scope="module")
def grey() -> np.ndarray:
    return np.full((90, 160, 3), 128, dtype=np.uint8)


def at_rest(scene: Scene) -> Trajectory:
    return Trajectory(np.array([0, 14_000_000]), np.tile(scene.ego.T_world_rig[100], (2, 1, 1)))


def instant(renderer: SceneRenderer, ego: Trajectory, time_us: int) -> np.ndarray:
    pose = ego.interpolate(np.array([time_us]))[0]
    return renderer.render(MOUNTED.camera, pose @ MOUNTED.T_rig_camera, time_us, pose).rgb


def test_no_effects_are_the_picture_itself(scene: Scene, renderer: SceneRenderer) -> None:
    film = Film(renderer, MOUNTED, NO_EFFECTS, seed=0)
    film.take(scene.ego, TIME)
    assert np.array_equal(film.develop()[0], instant(renderer, scene.ego, TIME))


def test_at_rest_no_shutter_can_be_seen(scene: Scene, renderer: SceneRenderer) -> None:
    ego = at_rest(scene)
    still = instant(renderer, ego, TIME).astype(int)
    for shutter in (Shutter(0.02), Shutter(0.0, 0.03), Shutter(0.02, 0.03, 3)):
        seen = expose(renderer, MOUNTED, ego, TIME, shutter).rgb
        assert (np.abs(seen - still).max(axis=-1) > 1).mean() < 0.002


def test_each_strip_of_a_rolling_shutter_is_of_its_own_time(scene: Scene, renderer: SceneRenderer) -> None:
    readout = 0.04
    seen = expose(renderer, MOUNTED, scene.ego, TIME, Shutter(0.0, readout)).rgb.astype(int)
    middle = instant(renderer, scene.ego, TIME).astype(int)
    rows = strip_rows(MOUNTED.camera)
    assert len(rows) == 12
    for row in (rows[7], rows[9], rows[11]):
        time_us = TIME + round(1e6 * readout * (row - 47.5) / 95)
        strip = slice(int(row - 3.5), int(row + 4.5))
        then = instant(renderer, scene.ego, time_us).astype(int)
        off = np.abs(seen[strip] - then[strip]).mean()
        assert off < 0.5
        assert off < 0.2 * np.abs(seen[strip] - middle[strip]).mean()


def test_a_long_exposure_is_the_mean_light_of_its_instants(scene: Scene, renderer: SceneRenderer) -> None:
    seen = expose(renderer, MOUNTED, scene.ego, TIME, Shutter(0.03, samples=3)).rgb
    moments = [instant(renderer, scene.ego, TIME + shift).astype(float) for shift in (-10_000, 0, 10_000)]
    expected = np.sqrt(np.mean(np.square(moments), axis=0))
    np.testing.assert_allclose(seen, expected, atol=0.51)


def test_the_shutter_sees_the_vehicle_stand_beyond_its_drive(scene: Scene, renderer: SceneRenderer) -> None:
    assert np.array_equal(
        expose(renderer, MOUNTED, scene.ego, 0, Shutter(0.02, samples=2)).distance,
        expose(renderer, MOUNTED, scene.ego, 5_000, Shutter()).distance,
    )


def test_noise_has_the_spread_that_is_asked_for(grey: np.ndarray) -> None:
    noisy = Imager(noise=6.0).record(grey, 1, 0).astype(float)
    assert noisy.mean() == pytest.approx(128.0, abs=0.2)
    assert noisy.std() == pytest.approx(6.0, rel=0.02)
    assert np.array_equal(Imager(noise=6.0).record(grey, 1, 0), noisy)
    assert not np.array_equal(Imager(noise=6.0).record(grey, 1, 33_333), noisy)
    dark = Imager(noise=6.0).record(np.full_like(grey, 40), 1, 0).astype(float)
    assert 3.0 < dark.std() < 5.0


def test_lamps_glow_into_the_dark_around_them(grey: np.ndarray) -> None:
    dark = np.zeros_like(grey)
    dark[44:47, 79:82] = 255
    glowing = Imager(glow=1.0).record(dark, 0, 0)
    assert glowing[45, 86].min() > 2 and glowing[45, 10].max() == 0
    assert np.array_equal(Imager(glow=1.0).record(grey, 0, 0), grey), "what is not bright does not glow"


def test_the_encoder_loses_less_at_a_higher_rate_and_repeats_itself(scene: Scene) -> None:
    frames = record_drive(scene, 161, 91, 10.0, window_us=(0, 1_000_000)).frames
    coarse, fine = (compress(frames, 10.0, rate) for rate in (40.0, 2000.0))
    assert coarse.shape == frames.shape, "odd sizes come back as they were"
    errors = [np.abs(coded.astype(int) - frames).mean() for coded in (coarse, fine)]
    assert 1.5 * errors[1] < errors[0] < 40.0
    assert np.array_equal(compress(frames, 10.0, 40.0), coarse)


def test_bonnet_and_reflections_stay_where_they_are(scene: Scene, renderer: SceneRenderer) -> None:
    film = Film(renderer, MOUNTED, CameraEffects(windscreen=Windscreen(bonnet=0.3)), seed=0)
    for time_us in (TIME, TIME + 500_000):
        film.take(scene.ego, time_us)
    first, second = film.develop()
    assert np.array_equal(first[80:, 60:100], second[80:, 60:100]), "the bonnet"
    assert not np.array_equal(first[:60], second[:60])
    black = np.zeros((96, 160, 3), dtype=np.uint8)
    glass = WindscreenGlass(Windscreen(reflection=1.0), (96, 160), 1.0, 0)
    reflected = glass.look_through(black, TIME)
    assert 5.0 < reflected.mean() < 60.0
    assert np.array_equal(glass.look_through(black, TIME + 777_777), reflected)


def test_drops_gather_until_the_wiper_comes() -> None:
    generator = np.random.default_rng(0)
    picture = generator.integers(0, 255, (90, 160, 3), dtype=np.uint8)

    def changed(glass: WindscreenGlass, time: float) -> float:
        return float((glass.look_through(picture, round(1e6 * time)) != picture).any(axis=-1).mean())

    wiped = WindscreenGlass(Windscreen(drops=1.0, wiper_seconds=2.0), (90, 160), 1.0, 3)
    assert changed(wiped, 0.7) < changed(wiped, 1.9)
    assert changed(wiped, 2.7) < changed(wiped, 1.9)
    never = WindscreenGlass(Windscreen(drops=1.0), (90, 160), 1.0, 3)
    assert changed(never, 0.7) == changed(never, 9.0) > changed(wiped, 1.9)
    white = np.full_like(picture, 255)
    blade = WindscreenGlass(Windscreen(wiper_seconds=2.0), (90, 160), 1.0, 3)
    passes = [blade.look_through(white, round(1e6 * time)).min() for time in (0.25, 1.0)]
    assert passes[0] < 60 and passes[1] == 255


def test_streaks_add_light_and_change_from_frame_to_frame(grey: np.ndarray) -> None:
    glass = WindscreenGlass(Windscreen(streaks=1.0), grey.shape[:2], 1.0, 0)
    one, other = (glass.look_through(grey, time_us).astype(int) for time_us in (0, 100_000))
    assert one.min() >= 128 and 0.01 < (one > 130).mean() < 0.5
    assert not np.array_equal(one, other)


def test_effects_belong_to_the_cameras_that_are_named(scene: Scene) -> None:
    effects = {FRONT_WIDE: CameraEffects(imager=Imager(noise=8.0), windscreen=Windscreen(drops=1.0))}
    window = (1_000_000, 1_200_000)
    plain = record_drive(scene, 64, 36, 10.0, (CROSS_LEFT,), window_us=window)
    noisy = record_drive(scene, 64, 36, 10.0, (CROSS_LEFT,), window_us=window, effects=effects)
    assert np.array_equal(plain.views[CROSS_LEFT], noisy.views[CROSS_LEFT])
    assert np.abs(plain.frames.astype(int) - noisy.frames).mean() > 3.0
    longer = record_drive(scene, 64, 36, 10.0, window_us=(0, 1_200_000), effects=effects)
    assert np.array_equal(longer.frames[-3:], noisy.frames), "a window is that part of the whole drive"


@pytest.mark.parametrize(
    ("build", "complaint"),
    [
        (lambda: Shutter(exposure_s=-0.1), "exposure -0.1"),
        (lambda: Shutter(samples=0), "0 samples"),
        (lambda: Imager(noise=-1.0), "noise -1"),
        (lambda: Windscreen(bonnet=1.5), "bonnet 1.5"),
        (lambda: Windscreen(wiper_seconds=0.0), "wiper every 0"),
        (lambda: CameraEffects(kilobits_per_second=0.0), "encoder rate 0"),
    ],
)
def test_impossible_effects_are_refused(build, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        build()
