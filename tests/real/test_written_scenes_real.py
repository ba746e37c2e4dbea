"""Public CommonRoad scenarios, OpenSCENARIO scenarios, road networks and an NVIDIA map through their readers.

The recorded ego replays to a perfect score and is driven along, or the gate says what does not hold.
"""

import gzip
import json

import numpy as np
import pytest

from olt_closed_loop.evaluation.gate import check_gate
from olt_closed_loop.scenes.sources import find_recordings, read_recording
from olt_generator.errors import InputError
from olt_generator.poses import yaw_of

from ..closed_loop.scenes import written_scenes as written

HIT = "replay scores 1"
# Seconds of the drive, agents, and the checks of the gate that do not hold.
COMMONROAD = {
    "USA_Lanker-1_1_T-1.xml": (4.0, 23, ()),
    "USA_Peach-4_8_T-1.xml": (6.0, 8, ()),
    "USA_US101-4_1_T-1.xml": (6.0, 21, ("0.1 m aside score as replayed",)),
}
ESMINI = {
    "acc-test": (35.2, 1, ("driving along scores as replayed",)),
    "alks_cut-in": (10.0, 1, (HIT,)),
    "cut-in": (22.0, 1, (HIT,)),
    "highway_merge": (14.2, 5, ()),
    "ltap-od": (9.6, 1, (HIT,)),
    "pedestrian": (14.3, 1, ()),
    "pedestrian_collision": (9.3, 1, (HIT,)),
    "slow-lead-vehicle": (11.3, 1, ()),
    "straight_500m": (22.5, 1, (HIT,)),
}
ALKS = {
    "4_1_1_free_driving": (120.0, 0, ()),
    "4_1_2_swerving_lead_vehicle": (50.0, 1, ()),
    "4_1_3_side_vehicle": (120.0, 1, ()),
    "4_2_1_fully_blocking_target": (40.0, 1, ()),
    "4_2_2_partially_blocking_target": (40.0, 1, ()),
    "4_2_3_crossing_pedestrian": (40.0, 1, ()),
    "4_2_4_multiple_blocking_targets": (40.0, 2, ()),
    "4_3_1_follow_lead_vehicle_comfortable": (54.9, 1, ()),
    "4_3_2_follow_lead_vehicle_emergency_brake": (21.6, 1, (HIT,)),
    "4_4_1_cut_in_no_collision": (21.8, 1, (HIT,)),
    "4_4_2_cut_in_unavoidable_collision": (20.9, 1, (HIT,)),
    "4_5_1_cut_out_fully_blocking": (40.0, 2, ()),
    "4_5_2_cut_out_multiple_blocking_targets": (40.0, 3, ()),
    "4_6_1_forward_detection_range": (40.0, 1, ()),
    "4_6_2_lateral_detection_range": (40.0, 1, ()),
}
TEMPLATES = "opendrive_openscenario/alks/logical_scenarios/concrete_scenarios"
SCENES = (
    {f"commonroad_recorded_scenarios/{name}": found for name, found in COMMONROAD.items()}
    | {f"opendrive_openscenario/esmini/xosc/{name}.xosc": found for name, found in ESMINI.items()}
    | {f"{TEMPLATES}/alks_scenario_{name}_template.xosc": found for name, found in ALKS.items()}
)


@pytest.mark.parametrize(
    "name",
    [
        name if "esmini" in name or "commonroad" in name else pytest.param(name, marks=pytest.mark.slow)
        for name in SCENES
    ],
)
def test_the_gate_holds_or_says_why_not(shared_real, name):
    scene = read_recording(shared_real / name)
    seconds, agents, failing = SCENES[name]
    assert (scene.ego.times[-1], len(scene.agents)) == (pytest.approx(seconds, abs=0.11), agents)
    result = check_gate(scene)
    # A drive that hits something fails whatever else is asked of it.
    assert result.failed[:1] == [] if not failing else result.failed[0].name in failing, result.failed


@pytest.mark.parametrize(
    "part",
    ["opendrive_openscenario/esmini/xodr", pytest.param("opendrive_openscenario/real_maps", marks=pytest.mark.slow)],
)
def test_road_networks_can_be_driven(shared_real, part):
    for path in find_recordings(shared_real / part):
        scene = read_recording(path)
        assert check_gate(scene).passed, path
        by_id = {lane.id: lane for lane in scene.lanes}
        gaps = [
            np.linalg.norm(by_id[other].center[0] - lane.center[-1])
            for lane in scene.lanes
            for other in lane.successors
        ]
        assert max(gaps, default=0.0) < (1.0 if "real_maps" in part else 1e-5)


def test_distributions_and_catalogues_are_refused(shared_real):
    folder = shared_real / "opendrive_openscenario/alks/logical_scenarios"
    for path in sorted(folder.glob("*.xosc")):
        with pytest.raises(InputError, match="a distribution of parameters, not a scenario"):
            read_recording(path)
    for path in sorted((folder / "concrete_scenarios/catalogs").glob("*/*.xosc")):
        with pytest.raises(InputError, match="a catalogue, not a scenario"):
            read_recording(path)


def test_an_archive_of_a_real_drive_and_its_map(shared_real, tmp_path):
    """Ego poses and lanes of an NVIDIA clip, packed as a NuRec archive: the drive stays on its lanes."""
    folder = shared_real / "nvidia_clip_map_and_ego_poses"
    poses = np.load(folder / "vehicle_pose.npy").astype(np.float64)
    u, _, vt = np.linalg.svd(poses[:, :3, :3])
    poses[:, :3, :3] = u @ vt
    members = written.nurec_members()
    rigs = json.loads(members["rig_trajectories.json"])
    drive = rigs["rig_trajectories"][0]
    drive["T_rig_worlds"] = poses.tolist()
    drive["T_rig_world_timestamps_us"] = np.round(10**9 + np.arange(len(poses)) * 1e6 / 30).astype(int).tolist()
    labels = json.loads(gzip.decompress((folder / "lanes.json.gz").read_bytes()))["labels"]
    members |= {
        "rig_trajectories.json": json.dumps(rigs).encode(),
        "clipgt/lane.parquet": written.parquet_bytes(list(_lanes(labels))),
    }
    del members["clipgt/wait_line.parquet"]
    scene = read_recording(written.write_nurec(tmp_path / "clip.usdz", members))
    assert len(scene.lanes) > 300 and scene.ego.path_length == pytest.approx(103.0, abs=0.5)
    assert sum(bool(lane.successors) for lane in scene.lanes) > 200
    result = check_gate(scene)
    assert result.checks[0].passed, result.checks
    distances = np.linalg.norm(scene.ego.positions[:, None, :2] - scene.route[None, :, :2], axis=-1).min(axis=1)
    assert distances.max() < 0.25 and abs(yaw_of(scene.ego.T_world_rig[-1])) < 0.2


def _lanes(labels):
    for number, label in enumerate(labels):
        left, right = (
            [dict(zip("xyz", map(float, vertex), strict=True)) for vertex in line["vertices"]]
            for line in label["labelData"]["shape3d"]["polylines3d"]["polylines"]
        )
        yield {
            "key": {"clip_id": "c", "map_id": str(number)},
            "lane": {"left_rail": left, "right_rail": right},
            "version": 1,
        }
