"""Recordings far from their origin, of any heading, and with times that repeat or run back, in every format."""

import json
import re
from dataclasses import dataclass

import numpy as np
import pytest

from olt_closed_loop.scenes.sources import read_recording
from olt_closed_loop.scoring.definitions import score_rollout
from olt_closed_loop.simulation.closed_loop import replay
from olt_generator.errors import InputError

from . import written_scenes as written
from .recordings import scenario, write_scenario


@dataclass(frozen=True)
class Motion:
    """A turn about the origin, radians, and then a shift in metres."""

    yaw: float
    x: float
    y: float

    def place(self, x, y):
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        return float(self.x + cos * x - sin * y), float(self.y + sin * x + cos * y)

    def heading(self, yaw):
        return float(np.arctan2(np.sin(yaw + self.yaw), np.cos(yaw + self.yaw)))


STAY = Motion(0.0, 0.0, 0.0)


def write_commonroad(folder, motion):
    def place(found):
        x, y = motion.place(*map(float, found.groups()))
        return f"<x>{x!r}</x><y>{y!r}</y>"

    content = re.sub("<x>(.*?)</x><y>(.*?)</y>", place, written.commonroad())
    content = content.replace("<orientation><exact>0.0<", f"<orientation><exact>{motion.heading(0.0)!r}<")
    path = folder / "one.xml"
    path.write_text(content)
    return path


def write_opendrive(folder, motion):
    def place(found):
        x, y, heading = map(float, found.groups())
        x, y = motion.place(x, y)
        return f' x="{x!r}" y="{y!r}" hdg="{motion.heading(heading)!r}"'

    path = folder / "roads.xodr"
    path.write_text(re.sub(' x="([^"]*)" y="([^"]*)" hdg="([^"]*)"', place, written.opendrive()))
    return path


def write_openscenario(folder, motion):
    path = written.write_openscenario(folder)
    write_opendrive(folder, motion)
    return path


def write_waymo(folder, motion):
    message = written.waymo_scenario()
    for track in message.tracks:
        for state in track.states:
            state.center_x, state.center_y = motion.place(state.center_x, state.center_y)
            state.heading = motion.heading(state.heading)
    for feature in message.map_features:
        for point in (*feature.lane.polyline, *feature.crosswalk.polygon):
            point.x, point.y = motion.place(point.x, point.y)
    return written.write_records(folder / "one.tfrecord", message.SerializeToString())


def write_nurec(folder, motion):
    members = written.nurec_members()
    rigs, tracks = (json.loads(members[name]) for name in ("rig_trajectories.json", "sequence_tracks.json"))
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(motion.yaw), -np.sin(motion.yaw)], [np.sin(motion.yaw), np.cos(motion.yaw)]]
    turn[:2, 3] = motion.x, motion.y
    (drive,) = rigs["rig_trajectories"]
    drive["T_rig_worlds"] = (turn @ np.array(drive["T_rig_worlds"])).tolist()
    for pose in tracks["dummy_chunk_id"]["tracks_data"]["tracks_poses"][0]:
        pose[:2] = motion.place(*pose[:2])
        pose[5:] = np.sin(motion.yaw / 2), np.cos(motion.yaw / 2)
    lanes = written.nurec_lanes()
    for lane in lanes:
        for rail in ("left_rail", "right_rail"):
            for point in lane["lane"][rail]:
                point["x"], point["y"] = motion.place(point["x"], point["y"])
    members |= {
        "rig_trajectories.json": json.dumps(rigs).encode(),
        "sequence_tracks.json": json.dumps(tracks).encode(),
        "clipgt/lane.parquet": written.parquet_bytes(lanes),
    }
    return written.write_nurec(folder / "one.usdz", members)


def write_nuscenes(folder, motion):
    content = scenario()
    for track in content["tracks"].values():
        state = track["state"]
        state["position"] = [[*motion.place(x, y), z] for x, y, z in state["position"]]
        state["heading"] = [motion.heading(yaw) for yaw in state["heading"]]
    for feature in content["map_features"].values():
        for name in {"polyline", "polygon"} & set(feature):
            feature[name] = [[*motion.place(*point[:2]), *point[2:]] for point in feature[name]]
    return write_scenario(folder / "one.json.gz", content)


FORMATS = {
    "commonroad": write_commonroad,
    "opendrive": write_opendrive,
    "openscenario": write_openscenario,
    "waymo": write_waymo,
    "nurec": write_nurec,
    "nuscenes": write_nuscenes,
}


def seen_from_start(scene):
    """Poses of ego and agents in the rig at the start, and whose they are."""
    T_rig_world = np.linalg.inv(scene.ego.T_world_rig[0])
    yaw = np.arctan2(T_rig_world[1, 0], T_rig_world[0, 0])
    places = [(T_rig_world @ scene.ego.T_world_rig)[:, :2, 3]]
    for agent in scene.agents:
        turned = agent.poses[:, 3] + yaw
        where = agent.poses[:, :2] @ T_rig_world[:2, :2].T + T_rig_world[:2, 3]
        places.append(np.column_stack([where, np.cos(turned), np.sin(turned)]))
    return [agent.id for agent in scene.agents], places


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("motion", [Motion(np.pi, 4.5e5, 5.4e6), Motion(-3.0, -1e6, 1e6)], ids=["west", "far"])
def test_where_it_was_recorded_and_which_way_it_headed_change_nothing(tmp_path, name, motion):
    scenes = []
    for kind in (STAY, motion):
        folder = tmp_path / f"{len(scenes)}"
        folder.mkdir()
        scenes.append(read_recording(FORMATS[name](folder, kind)))
    (names, places), (names_there, places_there) = map(seen_from_start, scenes)
    assert names == names_there
    for here, there in zip(places, places_there, strict=True):
        np.testing.assert_allclose(here, there, atol=1e-4)
    scores = [score_rollout(scene, replay(scene)) for scene in scenes]
    assert scores[0].score == scores[1].score == 1.0
    assert scores[0].offroad == scores[1].offroad
    assert scores[0].metrics["wrong_way"] == scores[1].metrics["wrong_way"]


def again(first):
    """A row of times whose first or last is there twice."""
    return lambda times: [times[0], *times[:-1]] if first else [*times[1:], times[-1]]


def reverse(times):
    return times[::-1]


def of_nuscenes(folder, change):
    content = scenario()
    content["metadata"]["ts"] = change(content["metadata"]["ts"])
    return write_scenario(folder / "one.json.gz", content)


def of_waymo(folder, change):
    message = written.waymo_scenario()
    message.timestamps_seconds[:] = change(list(message.timestamps_seconds))
    return written.write_records(folder / "one.tfrecord", message.SerializeToString())


def of_nurec(folder, change):
    members = written.nurec_members()
    rigs = json.loads(members["rig_trajectories.json"])
    (drive,) = rigs["rig_trajectories"]
    drive["T_rig_world_timestamps_us"] = change(drive["T_rig_world_timestamps_us"])
    return written.write_nurec(folder / "one.usdz", members | {"rig_trajectories.json": json.dumps(rigs).encode()})


def of_nurec_track(folder, change):
    members = written.nurec_members()
    tracks = json.loads(members["sequence_tracks.json"])
    data = tracks["dummy_chunk_id"]["tracks_data"]
    data["tracks_timestamps_us"] = [change(data["tracks_timestamps_us"][0])]
    return written.write_nurec(folder / "one.usdz", members | {"sequence_tracks.json": json.dumps(tracks).encode()})


def of_commonroad(number):
    """Of the obstacle with this number, which is the ego or another."""

    def write(folder, change):
        before, mark, after = written.commonroad().partition(f'<dynamicObstacle id="{number}">')
        own, end, rest = after.partition("</dynamicObstacle>")
        steps = iter(change([int(step) for step in re.findall("<time><exact>(.*?)<", own)]))
        own = re.sub("<time><exact>.*?<", lambda _: f"<time><exact>{next(steps)}<", own)
        path = folder / "one.xml"
        path.write_text(before + mark + own + end + rest)
        return path

    return write


def of_openscenario(folder, change):
    times = iter(change([0.0, 1.0, 2.0, 3.0]))
    vertices = "".join(
        f'<Vertex time="{time}"><Position><WorldPosition x="{x}" y="-2" h="0"/></Position></Vertex>'
        for x, time in zip((20, 28, 36, 44), times, strict=True)
    )
    action = written.private(
        '<RoutingAction><FollowTrajectoryAction><Trajectory name="way" closed="false"><Shape><Polyline>'
        f"{vertices}</Polyline></Shape></Trajectory>"
        '<TimeReference><Timing domainAbsoluteRelative="relative" scale="1" offset="0"/></TimeReference>'
        '<TrajectoryFollowingMode followingMode="position"/></FollowTrajectoryAction></RoutingAction>'
    )
    events = written.event("follow", action, written.trigger(written.after("1")))
    return written.write_openscenario(folder, events=events)


TIMED = {
    "nuscenes": of_nuscenes,
    "waymo": of_waymo,
    "nurec": of_nurec,
    "nurec track": of_nurec_track,
    "commonroad ego": of_commonroad(10),
    "commonroad": of_commonroad(11),
    "openscenario": of_openscenario,
}


@pytest.mark.parametrize("name", TIMED)
@pytest.mark.parametrize("change", [again(True), again(False), reverse], ids=["first", "last", "reversed"])
def test_times_that_repeat_or_run_back_are_refused(tmp_path, name, change):
    read_recording(TIMED[name](tmp_path, list))
    with pytest.raises(InputError, match=r"time|sample"):
        read_recording(TIMED[name](tmp_path, change))
