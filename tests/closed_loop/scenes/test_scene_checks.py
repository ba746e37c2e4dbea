"""Scene files that hold what no scene can, or point elsewhere: refused in words, and nothing elsewhere is opened."""

from dataclasses import replace

import numpy as np
import pytest

from olt_closed_loop.evaluation.evaluation import run_closed_loop
from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.scenes.scene import Hills, Scene
from olt_closed_loop.scenes.scene_file import read_looks, read_scene, write_scene
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.errors import InputError
from olt_generator.trajectory import Trajectory


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Scene:
    """A scene that brings its looks along, as they cannot be made of what is no scene."""
    path = write_scene(generate_scene("nominal", 3), tmp_path_factory.mktemp("whole") / "whole.usda")
    return read_scene(path)


def with_agent(**changes):
    return lambda scene: replace(scene, agents=(replace(scene.agents[0], **changes), *scene.agents[1:]))


def with_moved_agent(*by):
    return lambda scene: with_agent(poses=scene.agents[0].poses + by)(scene)


def with_vehicle(**changes):
    return lambda scene: replace(scene, vehicle=replace(scene.vehicle, **changes))


def with_poses(change):
    def changed(scene):
        poses = scene.ego.T_world_rig.copy()
        change(poses)
        return replace(scene, ego=Trajectory(scene.ego.timestamps_us, poses))

    return changed


def with_times(change):
    return lambda scene: replace(scene, ego=Trajectory(change(scene.ego.timestamps_us), scene.ego.T_world_rig))


def with_line(part, line):
    return lambda scene: replace(scene, **{part: (np.array(line, dtype=float).reshape(-1, 3), *getattr(scene, part))})


def with_lane(points):
    lines = dict.fromkeys(("center", "left", "right"), np.array(points, dtype=float))
    return lambda scene: replace(scene, lanes=(replace(scene.lanes[0], **lines), *scene.lanes[1:]))


def scale(poses):
    poses[:, :3, :3] *= 1.01


def flatten(poses):
    poses[:, :3, :3] = 0.0


def mirror(poses):
    poses[:, :3, 1] *= -1.0


def project(poses):
    poses[:, 3] = [0.0, 0.0, 0.1, 1.0]


def go_sideways(poses):
    poses[:, :3, :2] = poses[:, :3, 1::-1] * [1.0, -1.0]


def leave_the_map(poses):
    poses[:, 0, 3] += 1e300


def jump(poses):
    poses[30:, 0, 3] += 500.0


NO_SCENES = {
    "negative agent": (with_agent(length=-4.0), "agent parked_0: a box of -4 x"),
    "flat agent": (with_agent(height=0.0), "agent parked_0: a box of"),
    "endless agent": (with_agent(width=1e9), "agent parked_0: a box of"),
    "agent in another frame": (with_moved_agent(5e6, 0.0, 0.0, 0.0), "agent parked_0 at 0.00 s"),
    "agent without heading": (with_moved_agent(0.0, 0.0, 0.0, 1e300), "agent parked_0 at 0.00 s"),
    "two of a name": (lambda scene: replace(scene, agents=scene.agents * 2), "two agents are called parked_0"),
    "negative ego": (with_vehicle(length=-5.0), "length of -5 m"),
    "flat ego": (with_vehicle(width=0.0), "width of 0 m"),
    "endless ego": (with_vehicle(height=1e6), "height of 1e\\+06 m"),
    "no wheelbase": (with_vehicle(wheelbase=0.0), "wheelbase of 0 m"),
    "axle elsewhere": (with_vehicle(rear_axle_to_bbox_center=40.0), "the axle outside of its box"),
    "scaled": (with_poses(scale), "the ego at 0.00 s: its pose is more than"),
    "without axes": (with_poses(flatten), "the ego at 0.00 s: its pose is more than"),
    "mirrored": (with_poses(mirror), "the ego at 0.00 s: its pose is more than"),
    "projected": (with_poses(project), "the ego at 0.00 s: its pose is more than"),
    "sideways": (with_poses(go_sideways), "does not drive where its heading points"),
    "far": (with_poses(leave_the_map), "the ego's way: a point is farther than"),
    "jump": (with_poses(jump), "the ego moves"),
    "other unit of time": (with_times(lambda times: times * 1000), "a drive of"),
    "lane of a point": (with_lane([[0.0, 0.0, 0.0]]), "lane forward_0_0: 2 or more points"),
    "lane without length": (with_lane([[3.0, 3.0, 0.0]] * 4), "centre line has no length"),
    "edge of a point": (with_line("road_edges", [1.0, 2.0, 0.0]), "road edge 0: 2 or more points"),
    "no edge": (with_line("road_edges", []), "road edge 0: 2 or more points"),
    "outline of two points": (with_line("drivable", [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), "outline 0: 3 or more"),
    "outline far away": (with_line("drivable", [[1e30, 0, 0], [0, 1e30, 0], [0, 0, 0]]), "outline 0: a point"),
    "route of a point": (lambda scene: replace(scene, route=scene.route[:1]), "the route: 2 or more points"),
    "hills without step": (lambda scene: replace(scene, hills=Hills(0.0, 0.0, 0.0, np.zeros(3))), "hills: "),
    "hills without height": (lambda scene: replace(scene, hills=Hills(0.0, 0.0, 1.0, np.zeros(0))), "hills: "),
}


@pytest.mark.parametrize("name", NO_SCENES)
def test_what_no_scene_can_hold_is_refused_and_named(scene, tmp_path, name):
    change, named = NO_SCENES[name]
    path = write_scene(change(scene), tmp_path / "scene.usda")
    with pytest.raises(InputError, match=named) as caught:
        read_scene(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_file_without_a_scene_loses_its_own_rollouts_only(scene, straight_scene, tmp_path):
    bad = write_scene(with_vehicle(width=-2.0)(scene), tmp_path / "bad.usda")
    settings = SimulationSettings(duration_us=2_000_000)
    (refused, none), (driven, score) = run_closed_loop([str(bad), straight_scene()], "standing", 1, settings=settings)
    assert (refused.failure_kind, none.score, none.valid) == ("scene_refused", None, False)
    assert driven.failure is None and score.valid


@pytest.mark.parametrize("text", ["custom string olt:id", "custom string olt:name"])
def test_a_number_in_place_of_a_text_is_refused(scene, tmp_path, text):
    path = write_scene(scene, tmp_path / "scene.usda")
    before, mark, after = path.read_text().partition(text)
    path.write_text(f"{before}{mark.replace('string', 'int')} = 7\n{after.partition(chr(10))[2]}")
    with pytest.raises(InputError, match="7 stands where a text is expected"):
        read_scene(path)


ARCS = {
    "sublayer": ("#usda 1.0\n(", "#usda 1.0\n(\n    subLayers = [@FOLDER/elsewhere/other.usda@]", "the sublayer"),
    "sublayer that is itself": ("#usda 1.0\n(", "#usda 1.0\n(\n    subLayers = [@./scene.usda@]", "the sublayer"),
    "sublayer that is no layer": ("#usda 1.0\n(", "#usda 1.0\n(\n    subLayers = [@/etc/passwd@]", "the sublayer"),
    "reference": ("Agents", "references = @FOLDER/elsewhere/other.usda@</World/Agents>", "references"),
    "cycle": ("Agents", "references = </World>", "references"),
    "inherited": ("Agents", "inherits = </World/Agents>", "inherited prims"),
    "specialized": ("Agents", "specializes = </World/Road>", "specialized prims"),
    "variants": ("Agents", 'prepend variantSets = "which"', "variants"),
    "payload": ("Agents", "payload = @FOLDER/elsewhere/other.usda@", "a payload"),
    "clips": (
        "Agents",
        "clips = {\n dictionary default = {\n asset[] assetPaths = [@FOLDER/elsewhere/other.usda@]\n }\n }",
        "value clips",
    ),
}


@pytest.mark.parametrize("name", ARCS)
def test_nothing_is_composed_from_elsewhere(scene, tmp_path, name):
    """Neither other files nor prims in cycles: USD would leave out what it cannot open, with no more than a warning."""
    old, new, named = ARCS[name]
    other = tmp_path / "elsewhere" / "other.usda"
    write_scene(scene, other)
    path = write_scene(scene, tmp_path / "scene.usda")
    new = new.replace("FOLDER", str(tmp_path))
    if old == "Agents":
        old, new = 'def Scope "Agents"', f'def Scope "Agents" (\n{new}\n)'
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=f"has {named}"):
        read_scene(path)


def test_prims_that_refer_to_each_other_in_powers_of_two_are_no_bomb(scene, tmp_path):
    path = write_scene(scene, tmp_path / "scene.usda")
    twice = [
        "".join(f'def "{side}" (\nreferences = </P{n + 1}>\n)\n{{\n}}\n' for side in ("left", "right"))
        for n in range(40)
    ]
    prims = "".join(f'def "P{n}"\n{{\n{body}}}\n' for n, body in enumerate(twice))
    path.write_text(f'{path.read_text()}{prims}def "P40"\n{{\n}}\n')
    with pytest.raises(InputError, match="has references"):
        read_scene(path)


@pytest.mark.parametrize(
    "place", ["/etc/passwd", "../scene.looks.usda", "./scene.usda", "elsewhere/scene.looks.usda", "scene.looks.txt"]
)
def test_looks_are_the_file_beside_the_scene(scene, tmp_path, place):
    for folder in (tmp_path, tmp_path / "in", tmp_path / "in" / "elsewhere"):
        path = write_scene(scene, folder / "scene.usda")
    path = tmp_path / "in" / "scene.usda"
    path.write_text(path.read_text().replace("@./scene.looks.usda@", f"@{place}@"))
    assert read_scene(path).name == scene.name
    with pytest.raises(InputError, match="the payload of prim /World/Looks is not one file beside it"):
        read_looks(path)


def test_looks_point_nowhere_else(scene, tmp_path):
    path = write_scene(scene, tmp_path / "scene.usda")
    looks = tmp_path / "scene.looks.usda"
    looks.write_text(looks.read_text().replace("#usda 1.0\n(", "#usda 1.0\n(\n    subLayers = [@./scene.usda@]", 1))
    with pytest.raises(InputError, match=r"scene\.looks\.usda: has the sublayer"):
        read_looks(path)
