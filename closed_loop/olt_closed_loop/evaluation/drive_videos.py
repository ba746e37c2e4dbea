"""A rollout as a video: from above, around the ego, with plan, agents, contacts and moments."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.evaluation.drive_pictures import outline
from olt_closed_loop.evaluation.drive_views import DriveView
from olt_closed_loop.vehicle.state import STATE
from olt_generator.poses import Array
from olt_generator.video import write_video
from olt_toolkit.policy.contract import STEP_US

WIDTH, HEIGHT = 960, 640
PIXELS_PER_METRE = 8.0
BACK_SHARE = 0.3
"""Where the ego is: this share of the width from the left, facing right."""
FRAME_RATE = 10.0
_SHIFT = 4  # bits of a pixel's fraction, as OpenCV takes them
_LINGER_US = 1_500_000

Color = tuple[int, int, int]
_GROUND, _ROAD, _LINE, _EDGE = (246, 247, 249), (226, 229, 233), (176, 183, 191), (87, 96, 106)
_EGO, _AGENT, _PLAN, _PATH, _BAD, _TEXT = (
    (31, 111, 235),
    (154, 52, 18),
    (240, 136, 62),
    (75, 85, 99),
    (196, 33, 42),
    (20, 24, 30),
)


def film_drive(view: DriveView, path: Path) -> None:
    """Write an mp4 of 10 frames a second, one for each step of the drive."""
    frames = np.stack([draw_frame(view, row) for row in range(len(view.rollout.timestamps_us))])
    write_video(path, frames, FRAME_RATE)


def draw_frame(view: DriveView, row: int) -> NDArray[np.uint8]:
    """The picture (640, 960, 3) RGB of one step; the ego faces right."""
    rollout, scene = view.rollout, view.scene
    time_us = int(rollout.timestamps_us[row])
    image = np.full((HEIGHT, WIDTH, 3), _GROUND, dtype=np.uint8)
    pose = rollout.states[row, : STATE.speed]
    for area in scene.drivable:
        cv2.fillPoly(image, [_pixels(area, pose)], _ROAD, cv2.LINE_AA, _SHIFT)
    for lane in scene.lanes:
        _line(image, lane.left, pose, _LINE)
        _line(image, lane.right, pose, _LINE)
    for edge in scene.road_edges:
        _line(image, edge, pose, _EDGE, 2)
    _line(image, scene.ego.positions, pose, _PATH)
    if len(plans := np.flatnonzero(rollout.plan_times_us <= time_us)):
        _line(image, rollout.plans[plans[-1]], pose, _PLAN, 2)
    touched = {moment.agent_id for moment in view.moments if 0 <= time_us - moment.time_us <= _LINGER_US}
    for name, box in view.agents.items():
        if box.covers(np.array([time_us]))[0]:
            _box(image, outline(box, time_us), pose, _BAD if name in touched else _AGENT)
    _box(image, outline(view.ego, time_us), pose, _BAD if touched - {None} else _EGO)
    _write(image, view, row)
    return image


def _pixels(points: Array, pose: Array) -> NDArray[np.int32]:
    """Points (n, 2 or 3) of the world in pixels (n, 1, 2) of the picture around a pose, in parts of 1/16."""
    x, y, yaw = pose
    offset = points[:, :2] - (x, y)
    ahead = np.cos(yaw) * offset[:, 0] + np.sin(yaw) * offset[:, 1]
    left = np.cos(yaw) * offset[:, 1] - np.sin(yaw) * offset[:, 0]
    pixels = np.stack([BACK_SHARE * WIDTH + PIXELS_PER_METRE * ahead, 0.5 * HEIGHT - PIXELS_PER_METRE * left], axis=-1)
    return np.round(pixels * 2**_SHIFT).astype(np.int32)[:, None]


def _line(image: NDArray[np.uint8], points: Array, pose: Array, color: Color, width: int = 1) -> None:
    cv2.polylines(image, [_pixels(points, pose)], False, color, width, cv2.LINE_AA, _SHIFT)


def _box(image: NDArray[np.uint8], corners: Array, pose: Array, color: Color) -> None:
    cv2.fillPoly(image, [_pixels(corners, pose)], color, cv2.LINE_AA, _SHIFT)


def _write(image: NDArray[np.uint8], view: DriveView, row: int) -> None:
    rollout = view.rollout
    time_us = int(rollout.timestamps_us[row])
    driver = "recording" if time_us < rollout.handover_us else rollout.policy
    lines = [
        f"{view.seconds(time_us):5.1f} s   {rollout.states[row, STATE.speed]:5.1f} m/s   {driver}",
        *(moment.text for moment in view.moments if 0 <= time_us - moment.time_us <= _LINGER_US + STEP_US),
    ]
    for number, text in enumerate(lines[:6]):
        place = (12, 26 + 22 * number)
        cv2.putText(image, _plain(text), place, cv2.FONT_HERSHEY_SIMPLEX, 0.55, _TEXT, 1, cv2.LINE_AA)


def _plain(text: str) -> str:
    """OpenCV's letters are ASCII."""
    return text[:100].encode("ascii", "replace").decode()
