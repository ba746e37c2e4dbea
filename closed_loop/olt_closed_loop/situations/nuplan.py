"""nuPlan's classes of contacts, from the public description of its metric `no_ego_at_fault_collisions`.

At the first sample at which boxes overlap: `stopped ego` at 0.05 m/s or less; else `stopped track` likewise; else
`active rear` where the track's centre is more than 150 degrees from ahead of the ego's rear axle; else `active front`
where the front bumper is in the track's box; else `active lateral`. At fault are active front and stopped track, and
active lateral while the ego's corners are in several lanes or outside of all. Speeds are differences of the last two
samples; lanes that lead into each other count as one. AlpaSim and nuPlan look at samples only.
"""

import numpy as np
import shapely

from olt_closed_loop.rollouts.rollout_record import RolloutRecord
from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scoring.fault.lanes import LaneMap
from olt_closed_loop.scoring.moving_boxes import MovingBox, agent_box, ego_box, separations

STOPPED_SPEED = 0.05
BEHIND = np.deg2rad(150.0)


def classify_contact(record: RolloutRecord, agent_id: str) -> tuple[str, bool] | None:
    """nuPlan's class of the first contact with an agent after the hand-over and whether it is at fault; None: none."""
    ego = ego_box(record)
    box = next(agent_box(agent) for agent in record.agents if agent.id == agent_id)
    scored = record.timestamps_us >= record.handover_us
    times = np.intersect1d(record.timestamps_us[scored], box.timestamps_us)
    gaps, _ = separations(ego.at(times), ego.half_size, box.at(times), box.half_size)
    touching = times[gaps.max(axis=1) <= 0.0]
    if len(touching) == 0:
        return None
    time_us = int(touching[0])
    kind = _class_at(record, ego, box, time_us)
    lateral = kind == "active lateral" and not _in_one_lane(record, ego, time_us)
    return kind, kind in ("active front", "stopped track") or lateral


def _class_at(record: RolloutRecord, ego: MovingBox, box: MovingBox, time_us: int) -> str:
    if _speed(ego, time_us) <= STOPPED_SPEED:
        return "stopped ego"
    if _speed(box, time_us) <= STOPPED_SPEED:
        return "stopped track"
    pose, other = (body.at(np.array([time_us]))[0] for body in (ego, box))
    heading = np.array([np.cos(pose[3]), np.sin(pose[3])])
    offset = other[:2] - (pose[:2] - record.box.rear_axle_to_center * heading)
    if np.arccos(np.clip(heading @ offset / np.linalg.norm(offset), -1.0, 1.0)) > BEHIND:
        return "active rear"
    bumper = shapely.LineString(corners(pose, ego.half_size)[[0, 3]])
    front = bumper.intersects(shapely.Polygon(corners(other, box.half_size)))
    return "active front" if front else "active lateral"


def _speed(box: MovingBox, time_us: int) -> float:
    index = max(int(np.searchsorted(box.timestamps_us, time_us)), 1)
    (start, end), seconds = box.poses[index - 1 : index + 1], np.diff(box.timestamps_us[index - 1 : index + 1]) * 1e-6
    return float(np.hypot(*(end - start)[:2]) / seconds[0])


def _in_one_lane(record: RolloutRecord, ego: MovingBox, time_us: int) -> bool:
    """Whether all corners of the ego are in one lane or in lanes that lead into each other."""
    if not record.lanes:
        return False
    lanes = LaneMap(record.lanes, ego.poses[0, :2])
    outline = corners(ego.at(np.array([time_us]))[0], ego.half_size)
    return bool(set.intersection(*(lanes.linked(lanes.at(corner)) for corner in outline)))
