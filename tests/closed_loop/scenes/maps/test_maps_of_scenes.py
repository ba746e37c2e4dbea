"""Maps in scene files, on hills, in the camera's ground, from above and in the records that are scored."""

import re
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_closed_loop.rollouts.rollout_record import record_rollout
from olt_closed_loop.scenes.hills import lay_crest, lay_grade, put_on_hills
from olt_closed_loop.scenes.maps.arms import Arm
from olt_closed_loop.scenes.maps.carriageways import carriageway
from olt_closed_loop.scenes.maps.cross_sections import CrossSection
from olt_closed_loop.scenes.maps.drawing import draw_map
from olt_closed_loop.scenes.maps.lanes import Light
from olt_closed_loop.scenes.maps.roundabouts import roundabout
from olt_closed_loop.scenes.scene_file import read_scene, write_scene
from olt_closed_loop.scenes.scene_map import map_of, with_map
from olt_closed_loop.sensors.ground import ASPHALT, GRASS, KERB, PAINT, SIDEWALK, draw_materials
from olt_closed_loop.simulation.closed_loop import simulate
from olt_closed_loop.simulation.policies import StandingPolicy
from olt_generator.errors import InputError

from .crossroads import crossroads_scene

PARTS = ("lanes", "road_edges", "drivable", "stop_lines", "crossings", "lights")


@pytest.fixture(scope="module")
def scene():
    return crossroads_scene()


def assert_same(one, other):
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype and np.array_equal(one, other)
        return
    assert type(one) is type(other)
    for field in fields(one):
        first, second = getattr(one, field.name), getattr(other, field.name)
        same = np.array_equal(first, second) if isinstance(first, np.ndarray) else first == second
        assert same, field.name


@pytest.mark.parametrize("suffix", ["usda", "usdc"])
def test_a_map_survives_a_file(scene, tmp_path, suffix):
    path = write_scene(scene, tmp_path / f"scene.{suffix}")
    again = read_scene(path)
    for part in PARTS:
        assert len(getattr(scene, part)) == len(getattr(again, part)) > 0
        for one, other in zip(getattr(scene, part), getattr(again, part), strict=True):
            assert_same(one, other)
    assert {type(light.timestamps_us) for light in again.lights} == {np.ndarray}
    second = write_scene(again, tmp_path / "again" / f"scene.{suffix}")
    if suffix == "usda":
        assert second.read_bytes() == path.read_bytes()


def test_a_map_of_one_moment(tmp_path):
    one = crossroads_scene(0.0, 1)
    again = read_scene(write_scene(one, tmp_path / "scene.usda"))
    assert len(again.ego) == 1 and again.lights[0].state_at(0) == one.lights[0].state_at(0)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('olt:type = "driving"', 'olt:type = "tramway"', "type is tramway; one of driving"),
        ('olt:left_marking = "double"', 'olt:left_marking = "dotted"', "left_marking is dotted"),
        ('olt:right_crossable = "yes"', 'olt:right_crossable = "maybe"', "right_crossable is maybe; yes or no"),
        ("olt:right_wear = 0.25", "olt:right_wear = 7", "right_wear is 7"),
        ('olt:control = "stop"', 'olt:control = "go"', "control is go"),
        ('olt:zebra = "yes"', 'olt:zebra = "perhaps"', "zebra is perhaps"),
        ('"green", "amber"', '"green", "blue"', "state blue is none of red"),
        ('["green", ', '["green", "green", ', "one time for each state"),
        ("olt:timestamps_us = [", "olt:timestamps_us = [1e300, ", "one time for each state"),
    ],
)
def test_what_a_map_cannot_say_is_refused(scene, tmp_path, old, new, complaint):
    path = write_scene(scene, tmp_path / "scene.usda")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=rf"prim /World/Road/\w+/\w+: .*{re.escape(complaint)}"):
        read_scene(path)


@given(st.floats(-np.pi, np.pi), st.floats(-100.0, 100.0), st.floats(-6.0, 6.0), st.floats(20.0, 120.0))
def test_crests_and_dips_rise_to_their_height_and_end(direction, place, height, length):
    hills = lay_crest(direction, place, height, length)
    along = np.array([np.cos(direction), np.sin(direction)])
    middle, before, behind = (hills.height(at * along) for at in (place, place - length, place + length))
    assert middle == pytest.approx(height, abs=0.1 * abs(height) / 5.0 + 1e-9)
    assert before == behind == 0.0


def test_a_grade_rises_by_its_slope():
    hills = lay_grade(0.3, -20.0, 100.0, 0.06)
    along = np.array([np.cos(0.3), np.sin(0.3)])
    heights = hills.height(np.array([-100.0, 20.0, 40.0, 300.0])[:, None] * along)
    assert heights[0] == 0.0 and heights[-1] == pytest.approx(6.0)
    assert heights[2] - heights[1] == pytest.approx(1.2)
    with pytest.raises(InputError, match="cannot be rounded"):
        lay_grade(0.0, 0.0, 10.0, 0.06)


def test_all_of_a_map_lies_on_hills_and_stays_where_it_is(scene):
    hills = lay_crest(0.2, 0.0, 4.0, 100.0)
    lifted = put_on_hills(scene, hills)
    before, after = map_of(scene), map_of(lifted)
    pairs = [
        *((a.center, b.center) for a, b in zip(before.lanes, after.lanes, strict=True)),
        *((a.points, b.points) for a, b in zip(before.stop_lines, after.stop_lines, strict=True)),
        *((a.outline, b.outline) for a, b in zip(before.crossings, after.crossings, strict=True)),
        *((a.position, b.position) for a, b in zip(before.lights, after.lights, strict=True)),
        *zip(before.drivable, after.drivable, strict=True),
    ]
    for one, other in pairs:
        assert np.array_equal(one[..., :2], other[..., :2])
        np.testing.assert_allclose(other[..., 2] - one[..., 2], hills.height(one), atol=1e-12)
    assert [lane.successors for lane in after.lanes] == [lane.successors for lane in before.lanes]


def material(raster, x, y):
    column, row = np.round(raster.pixels(np.array([[x, y]]))[0]).astype(int)
    return int(raster.image[row, column])


def test_the_ground_shows_what_the_map_says(scene):
    raster = draw_materials(scene)
    (bars, _), road_map = scene.crossings, map_of(scene)
    assert material(raster, *road_map.lane("arm1_in_sidewalk").center[3, :2]) == SIDEWALK
    assert material(raster, *road_map.lane("arm1_in_sidewalk").left[3, :2]) > KERB - 30
    line = next(line for line in scene.stop_lines if line.control == "light")
    assert material(raster, *line.points.mean(axis=0)[:2]) == PAINT
    solid = road_map.lane("arm3_in_cycle").left[10, :2]
    worn = PAINT - 0.25 * (PAINT - ASPHALT)
    assert material(raster, *solid) == pytest.approx(worn, abs=1)
    (west, south), (east, north) = bars.outline[:, :2].min(axis=0), bars.outline[:, :2].max(axis=0)
    across = [material(raster, (west + east) / 2.0, y) for y in np.arange(south + 0.2, north - 0.2, 0.05)]
    painted = np.array(across) > 240
    assert 0.35 < painted.mean() < 0.65 and np.count_nonzero(np.diff(painted.astype(int)) == 1) >= 5
    (_, unknown) = scene.crossings
    inside = unknown.outline[:, :2].mean(axis=0)
    assert all(material(raster, inside[0] + step, inside[1]) < 200 for step in np.arange(-2.0, 2.0, 0.1))


def test_unpainted_roads_and_islands(scene):
    bare = with_map(scene, carriageway(100.0, 2, 2, CrossSection(wear=1.0)))
    raster = draw_materials(bare)
    values = [material(raster, 50.0, y) for y in np.arange(-7.0, 7.0, 0.05)]
    assert set(values) == {ASPHALT}
    ring = with_map(scene, roundabout([Arm(0.0), Arm(2.0), Arm(4.0)]))
    raster = draw_materials(ring)
    assert material(raster, 0.0, 0.0) == GRASS
    # The island cuts the road into several outlines, whose seams are not seen.
    angles = np.linspace(0.0, 2.0 * np.pi, 400)
    assert {material(raster, 17.0 * np.cos(angle), 17.0 * np.sin(angle)) for angle in angles} == {ASPHALT}


def test_a_picture_from_above(scene, tmp_path):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    figure, axes = pyplot.subplots()
    draw_map(axes, map_of(scene), 0)
    lamps = [line for line in axes.lines if line.get_marker() == "o"]
    assert [line.get_color() for line in lamps] == ["#2ca02c", "#2ca02c"]
    pyplot.close(figure)


def test_the_record_knows_red_lights_and_lanes_for_cars(scene):
    light = Light("red", ("arm2_in_0>arm0_out_0",), np.array([0, 1_500_000]), ("red", "green"))
    ruled = replace(scene, lights=(light,))
    record = record_rollout(ruled, simulate(ruled, StandingPolicy()))
    cars = [lane for lane in scene.lanes if lane.for_cars]
    assert len(record.lanes) == len(cars) < len(scene.lanes)
    for lane, lines in zip(cars, record.lanes, strict=True):
        if lane.id in light.lanes:
            assert lines.red_us is not None and lines.red_us.tolist() == [[0, 1_500_000]]
        else:
            assert lines.red_us is None
