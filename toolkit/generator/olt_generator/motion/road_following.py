"""How fast, and whether forward or backward, a vehicle drives: the road followed over a whole clip."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from olt_generator.motion.features import Gray
from olt_generator.motion.road_grid import RoadGrid, road_frame
from olt_generator.motion.road_speed import LongerVotes, RoadSpeed, count_votes, estimate_speed
from olt_generator.motion.steps import Step
from olt_generator.poses import Array

# Directions of steps that agree to this are told apart from those that what moves by itself has bent.
AGREEING_DIRECTIONS = np.radians(10.0)
# A step goes aside by so much at most: by shaking, and the more the more it turns, because the camera is ahead of the
# axle. What goes farther aside follows something that moves by itself.
MOST_ASIDE, MOST_ASIDE_BY_TURN = np.radians(5.0), 5.0
# Motion that is slower than this is measured over more than one step: over so many metres, and at most so many steps.
SLOW_SPEED = 5.0
SLOW_METRES = 0.8
# Votes over a single step count where it is longer than the first of these, and in full from the second on, metres.
TOLD_METRES = (0.15, 0.3)
MOST_STEPS = 8


def usual_direction(steps: Sequence[Step], forward: Array) -> Array:
    """Direction (3,) in camera axes along which most steps go, taken ahead; `forward` (3,) if they do not agree.

    The steps' directions hold up to their sign; ahead is where `forward` points.
    """
    directions = ahead([step for step in steps if step.moves], forward)
    if len(directions) == 0:
        return forward
    middle = directions[np.argmin(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)).sum(axis=1))]
    near = directions @ middle > np.cos(AGREEING_DIRECTIONS)
    if np.count_nonzero(near) < 0.5 * len(directions):
        return forward
    mean = np.median(directions[near], axis=0)
    return mean / np.linalg.norm(mean)


def ahead(steps: Sequence[Step], forward: Array) -> Array:
    """Directions (n, 3) of the steps, each with the sign that points ahead."""
    directions = np.array([step.motion.direction_a for step in steps]).reshape(-1, 3)
    return np.where((directions @ forward < 0.0)[:, None], -directions, directions)


def follow_road(
    grays: Sequence[Gray], seconds: Array, steps: Sequence[Step], grid: RoadGrid, travel: Array, up: Array
) -> RoadSpeed:
    """Signed speed over every step.

    Args:
        grays: n + 1 keyframes.
        seconds: (n,) duration of each step.
        steps: n steps between them.
        grid: where the camera sees the road.
        travel, up: (3,) usual direction ahead, and rough up direction, in camera axes.
    """
    directions = ahead(steps, travel)
    moves = np.array([step.moves for step in steps])
    votes = np.zeros((len(steps), len(grid.shifts)))
    for step in range(len(steps)):
        votes[step] = _vote(grays, seconds, steps, directions, grid, travel, up, step, step + 1)
    speed = estimate_speed(votes, grid.shifts, seconds)
    slow = moves & (np.abs(speed.speed) < SLOW_SPEED)
    if not slow.any():
        return speed
    longer = LongerVotes(np.zeros_like(votes), seconds.copy())
    for step in np.flatnonzero(slow).tolist():
        wanted = round(SLOW_METRES / max(abs(float(speed.speed[step])) * float(seconds[step]), 1e-6))
        count = min(int(np.clip(wanted, 1, MOST_STEPS)), len(steps))
        first = int(np.clip(step - (count - 1) // 2, 0, len(steps) - count))
        last = first + count
        if count > 1:
            longer.votes[step] = _vote(grays, seconds, steps, directions, grid, travel, up, first, last)
            longer.lasts[step] = seconds[first:last].sum()
            driven = abs(float(speed.speed[step])) * float(seconds[step])
            votes[step] *= float(np.interp(driven, TOLD_METRES, [0.0, 1.0]))
    return estimate_speed(votes, grid.shifts, seconds, longer)


def _vote(
    grays: Sequence[Gray],
    seconds: Array,
    steps: Sequence[Step],
    directions: Array,
    grid: RoadGrid,
    travel: Array,
    up: Array,
    first: int,
    last: int,
) -> Array:
    """Votes (shifts,) for the distance driven from one keyframe to a later one."""
    turned, moved = np.eye(3), np.zeros(3)
    for step, direction in zip(steps[first:last], directions[first:last], strict=True):
        moved += turned.T @ direction
        turned = step.motion.R_b_a @ turned
    aside = float(np.arccos(np.clip(moved @ travel / max(float(np.linalg.norm(moved)), 1e-9), -1.0, 1.0)))
    possible = aside < MOST_ASIDE + MOST_ASIDE_BY_TURN * Rotation.from_matrix(turned).magnitude()
    axes = road_frame(travel, up, moved if possible else travel)
    matches = grid.match(grid.rectify(grays[first], axes), grid.rectify(grays[last], axes.rotated(turned)))
    return count_votes(matches, float(seconds[first:last].sum()))
