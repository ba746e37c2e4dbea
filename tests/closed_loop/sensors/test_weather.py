"""Night, low sun and rain: what they change in a picture, and what they leave."""

from dataclasses import replace

import numpy as np
import pytest

from olt_closed_loop.scenes.conditions import CLEAR_DAY, Conditions, relight
from olt_closed_loop.scenes.hills import Wave, lay_hills, put_on_hills
from olt_closed_loop.scenes.looks import generate_looks
from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.sensors.ray_casting import Rendering, SceneRenderer
from olt_generator.cameras import PinholeCamera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig

CAMERA = PinholeCamera.from_field_of_view(160, 90, np.radians(70.0))
MOUNTING = camera_pose_in_rig([1.5, 0.0, 1.5], 0.0, 0.05, 0.0)
ROAD = np.s_[60:88, 40:120]
NIGHT = Conditions("night", street_lights=False)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return replace(generate_scene("nominal", 3), agents=())


def shoot(scene: Scene, conditions: Conditions = CLEAR_DAY, with_vehicle: bool = True) -> Rendering:
    pose = scene.ego.T_world_rig[0]
    return SceneRenderer(scene, conditions).render(CAMERA, pose @ MOUNTING, 0, pose if with_vehicle else None)


def car(scene: Scene, ahead: float, moves: bool, turn: float = 0.0) -> Agent:
    """A car in front of the recorded start; one that moves creeps a millimetre."""
    start = scene.ego.T_world_rig[0]
    x, y = (start @ [ahead, 0.0, 0.0, 1.0])[:2]
    poses = np.tile([x, y, 0.75, np.arctan2(start[1, 0], start[0, 0]) + turn], (2, 1))
    poses[1, 0] += 0.001 * moves
    return Agent("car", "automobile", 4.6, 1.85, 1.5, np.array([0, 14_000_000]), poses)


def test_geometry_does_not_depend_on_light_and_weather(scene: Scene) -> None:
    day = shoot(scene).distance
    for conditions in (Conditions("low_sun"), Conditions("night", 0.5), Conditions("day", 1.0)):
        seen = shoot(scene, conditions).distance
        lamps = seen < day  # the lamps of street lights hang there at night alone
        assert lamps.mean() < (0.02 if conditions.light == "night" else 1e-9)
        assert np.array_equal(seen[~lamps], day[~lamps])


def test_a_clear_day_is_the_looks_themselves(scene: Scene) -> None:
    looks = generate_looks(scene)
    assert relight(looks, CLEAR_DAY) is looks
    assert relight(looks, Conditions("low_sun")).sun_direction[2] == pytest.approx(np.sin(np.radians(7.0)))


def test_a_night_is_dark_but_for_headlights_and_street_lights(scene: Scene) -> None:
    day, dark = shoot(scene).rgb, shoot(scene, NIGHT, with_vehicle=False).rgb
    assert dark.mean() < 0.1 * day.mean()
    own = shoot(scene, NIGHT).rgb
    assert own[ROAD].mean() > 5.0 * dark[ROAD].mean()
    sky = np.isinf(shoot(scene, NIGHT).distance)
    assert np.array_equal(own[sky], dark[sky])
    street = SceneRenderer(scene, Conditions("night"))
    everywhere = [street.render(CAMERA, pose @ MOUNTING, 0).rgb.mean() for pose in scene.ego.T_world_rig[::100]]
    assert max(everywhere) > 1.5 * dark.mean()


def test_lamps_of_vehicles_burn_unless_they_are_parked(scene: Scene) -> None:
    def reddest(moves: bool) -> int:
        lit = replace(scene, agents=(car(scene, 12.0, moves),))
        rgb = shoot(lit, NIGHT, with_vehicle=False).rgb.astype(int)
        return int((rgb[..., 0] - rgb[..., 1]).max())

    assert reddest(moves=True) > 150
    assert reddest(moves=False) < 30
    oncoming = replace(scene, agents=(car(scene, 25.0, True, np.pi),))
    dark = shoot(scene, NIGHT, with_vehicle=False).rgb
    before = shoot(oncoming, NIGHT, with_vehicle=False).rgb
    assert before[ROAD].mean() > 1.5 * dark[ROAD].mean(), "its headlights light the road before it"


def test_a_wet_road_mirrors_what_stands_on_it(scene: Scene) -> None:
    with_car = replace(scene, agents=(car(scene, 15.0, True),))
    rain = Conditions("day", 1.0)

    def change(conditions: Conditions) -> np.ndarray:
        empty, full = shoot(scene, conditions), shoot(with_car, conditions)
        below = (full.distance == empty.distance) & (np.mgrid[:90, :160][0] > 50)
        difference = np.abs(full.rgb.astype(int) - empty.rgb).sum(axis=-1)
        return np.where(below, difference, 0)[:, 60:100]

    wet = change(rain)
    assert (wet > 20).sum() > 60
    # The image of the car lies straight below it, and nothing of it at the sides of the picture.
    columns = np.flatnonzero((wet > 20).any(axis=0))
    assert columns.min() > 2 and columns.max() < 37


def test_rain_hides_the_sun_and_the_distance(scene: Scene) -> None:
    day, rain = shoot(scene).rgb.astype(float), shoot(scene, Conditions("day", 0.6)).rgb.astype(float)
    sky = np.s_[:20]
    assert np.ptp(rain[sky].mean(axis=(0, 1))) < 0.3 * np.ptp(day[sky].mean(axis=(0, 1))), "the sky is grey"
    assert Conditions(rain=1.0).haze_distance < 0.3 * CLEAR_DAY.haze_distance


def test_hills_hide_what_lies_behind_a_crest(scene: Scene) -> None:
    start = scene.ego.T_world_rig[0]
    heading = float(np.arctan2(start[1, 0], start[0, 0]))
    along = float(start[0, 3] * np.cos(heading) + start[1, 3] * np.sin(heading))
    # A dip at the vehicle and a crest 80 m ahead.
    wave = Wave(2.0, 160.0, float(-np.pi / 2 - 2 * np.pi / 160.0 * along))
    hilly = put_on_hills(scene, lay_hills(heading, (wave,)))
    assert hilly.hills is not None
    pose = hilly.ego.T_world_rig[0] @ MOUNTING
    places = pose[:3, 3] + shoot(hilly).distance[..., None] * (pixel_rays(CAMERA) @ pose[:3, :3].T)
    seen = np.isfinite(places).all(axis=-1)
    above = places[seen][:, 2] - hilly.hills.height(places[seen])
    assert above.min() > -0.05, "nothing is seen below the ground"
    ahead = places[seen][np.abs(above) < 0.02] @ [np.cos(heading), np.sin(heading), 0.0] - along
    assert 40.0 < ahead.max() < 82.0, "ground is seen up to the crest"


@pytest.mark.parametrize(("values", "complaint"), [({"light": "dusk"}, "light 'dusk'"), ({"rain": 1.5}, "rain 1.5")])
def test_impossible_conditions_are_refused(values: dict[str, object], complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        Conditions(**values)  # type: ignore[arg-type]


def test_fog_hides_what_is_far(scene: Scene) -> None:
    pictures = [shoot(scene, Conditions(fog=fog)) for fog in (0.0, 0.4, 1.0)]
    far = (pictures[0].distance > 80.0) & np.isfinite(pictures[0].distance)
    spread = [picture.rgb[far].std(axis=0).mean() for picture in pictures]
    assert spread[0] > spread[1] > 3.0 * spread[2]
    assert all(np.array_equal(picture.distance, pictures[0].distance) for picture in pictures)
