"""Scene files: nothing is lost, looks stay unloaded, damage is named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf

from olt_closed_loop.scenes.hills import Wave, lay_hills, put_on_hills
from olt_closed_loop.scenes.looks import generate_looks
from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.scene_file import read_looks, read_scene, write_scene
from olt_generator.errors import InputError
from olt_generator.trajectory import Trajectory


@pytest.fixture(scope="module")
def scene() -> Scene:
    return generate_scene("work_zone", 3)


def assert_same_scene(first: Scene, second: Scene) -> None:
    assert (first.name, first.category, first.factors) == (second.name, second.category, second.factors)
    assert first.vehicle == second.vehicle
    assert np.array_equal(first.ego.timestamps_us, second.ego.timestamps_us)
    np.testing.assert_allclose(first.ego.T_world_rig, second.ego.T_world_rig, rtol=0, atol=1e-9)
    assert len(first.agents) == len(second.agents) and len(first.lanes) == len(second.lanes)
    for one, other in zip(first.agents, second.agents, strict=True):
        assert (one.id, one.label) == (other.id, other.label)
        assert (one.length, one.width, one.height) == (other.length, other.width, other.height)
        assert np.array_equal(one.timestamps_us, other.timestamps_us) and other.timestamps_us.dtype == np.int64
        np.testing.assert_allclose(one.poses, other.poses, rtol=0, atol=1e-9)
    for one, other in zip(first.lanes, second.lanes, strict=True):
        assert (one.id, one.successors) == (other.id, other.successors)
        for side in ("center", "left", "right"):
            assert np.array_equal(getattr(one, side), getattr(other, side))
    for name in ("road_edges", "drivable"):
        assert all(map(np.array_equal, getattr(first, name), getattr(second, name)))
        assert len(getattr(first, name)) == len(getattr(second, name))
    assert np.array_equal(first.route, second.route)


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_round_trip_is_exact(scene: Scene, tmp_path: Path, suffix: str) -> None:
    path = write_scene(scene, tmp_path / f"scene{suffix}")
    again = read_scene(path)
    assert_same_scene(scene, again)
    assert again.looks == str(path)
    assert read_looks(path) == generate_looks(scene)


def test_hills_are_kept(scene: Scene, tmp_path: Path) -> None:
    hilly = put_on_hills(scene, lay_hills(0.3, (Wave(4.0, 150.0, 1.0),)))
    again = read_scene(write_scene(hilly, tmp_path / "scene.usda"))
    assert_same_scene(hilly, again)
    assert hilly.hills is not None and again.hills is not None
    assert np.array_equal(again.hills.heights, hilly.hills.heights)
    assert np.array_equal(again.hills.height(scene.route), hilly.hills.height(scene.route))
    assert read_scene(write_scene(scene, tmp_path / "level.usda")).hills is None


def test_odd_microseconds_far_coordinates_and_any_id_survive(scene: Scene, tmp_path: Path) -> None:
    times = np.array([1, 33_367, 1_700_000_000_000_001], dtype=np.int64)
    poses = np.array([[5e6 + 0.1, -5e6 - 1e-7, 0.75, 7.0]] * 3)
    odd = replace(scene.agents[0], id="12 ü/§", timestamps_us=times, poses=poses)
    away = scene.ego.T_world_rig.copy()
    away[:, :2, 3] += (5e6, -5e6)
    ego = Trajectory(scene.ego.timestamps_us, away)
    changed = replace(scene, ego=ego, agents=(odd, replace(odd, id="12 ü.§")))
    assert_same_scene(changed, read_scene(write_scene(changed, tmp_path / "scene.usda")))


def test_same_scene_gives_the_same_bytes(scene: Scene, tmp_path: Path) -> None:
    for folder in ("a", "b"):
        write_scene(scene, tmp_path / folder / "scene.usda")
    for name in ("scene.usda", "scene.looks.usda"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["scene.looks.usda", "scene.usda"]


def test_reading_a_scene_leaves_its_looks_unopened(scene: Scene, tmp_path: Path) -> None:
    path = write_scene(scene, tmp_path / "scene.usda")
    looks = tmp_path / "scene.looks.usda"
    read_scene(path)
    assert Sdf.Layer.Find(str(looks)) is None
    looks.unlink()
    assert_same_scene(scene, read_scene(path))
    with pytest.raises(InputError, match=r"scene\.looks\.usda: no such file"):
        read_looks(path)


def test_a_written_scene_can_be_written_again(scene: Scene, tmp_path: Path) -> None:
    first = write_scene(scene, tmp_path / "first.usda")
    second = write_scene(read_scene(first), tmp_path / "second.usda")
    assert_same_scene(scene, read_scene(second))
    assert read_looks(second) == read_looks(first)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("not a stage", "not a USD stage"),
        ("#usda 1.0\n", "timeCodesPerSecond are 0.01, Y, 24"),
        ('#usda 1.0\n(metersPerUnit = 1\nupAxis = "Z"\ntimeCodesPerSecond = 1000000)\n', "prim /World is missing"),
    ],
)
def test_what_is_not_a_scene_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "scene.usda"
    path.write_text(text)
    with pytest.raises(InputError, match=complaint) as error:
        read_scene(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("cut", "complaint"),
    [
        ("custom string olt:category", "prim /World lacks attribute olt:category"),
        ("custom double olt:wheelbase", "prim /World/Ego lacks attribute olt:wheelbase"),
        ("custom double3[] olt:left", "prim /World/Road/Lanes/lane_000 lacks attribute olt:left"),
        ('def BasisCurves "Route"', "prim /World/Road/Route is missing"),
    ],
)
def test_what_a_scene_lacks_is_named(scene: Scene, tmp_path: Path, cut: str, complaint: str) -> None:
    path = write_scene(scene, tmp_path / "scene.usda")
    text = path.read_text()
    assert cut in text
    path.write_text(text.replace(cut, cut.replace("olt:", "olt:no_").replace("Route", "NoRoute"), 1))
    with pytest.raises(InputError, match=complaint):
        read_scene(path)


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_scene(tmp_path / "scene.usda")
