"""Scenes to learn from: the events of the suite and ordinary drives, on roads that no scene of the suite has.

They come from seeds of their own, and roads are drawn by `suite.training_roads`. Where the one who sees everything
finds no clean drive through an event, it is drawn anew, so every recorded drive is one to learn from. With a
disturbance (`suite.disturbances`) a drive comes in legs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from olt_closed_loop.privileged.plan import Drive, is_clean, plan_drive
from olt_closed_loop.privileged.truth import Truth
from olt_closed_loop.scenes.driving import SAMPLE_US
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.suite.catalogue import CATEGORIES, CURVED, EVENTS, LEFT, Entry
from olt_closed_loop.suite.courses import DURATION_US
from olt_closed_loop.suite.disturbances import Disturbance, Push, is_free, is_gentle, misjudged_drive
from olt_closed_loop.suite.event import Event
from olt_closed_loop.suite.everyday import NOMINAL, ORDINARY_STOPS
from olt_closed_loop.suite.recorded_drives import (
    BEYOND_US,
    SEES_US,
    first_drives,
    joined,
    speed_at,
    truth_of_event,
)
from olt_closed_loop.suite.scenes import name_and_seed, scene_of_event
from olt_closed_loop.suite.training_roads import TrainingRoads
from olt_generator.errors import InputError
from olt_generator.poses import Array, planar_pose
from olt_generator.seeds import derive_seed, make_generator
from olt_generator.trajectory import Trajectory
from olt_toolkit.policy.window import FUTURE_OFFSETS_US

PREFIX = "training/"
"""How the names of these scenes begin, as in training/closed_lane:3."""
RECOVERY = "recovery"
"""The factor of the legs that begin with a push."""
LAST_IMAGE_US = DURATION_US - int(FUTURE_OFFSETS_US[-1])
"""The last time that gives a sample: its future is known."""
Poses = tuple[Array, Array, Array]
"""x, y, yaw (n,) of the rig in the world."""
_ATTEMPTS = 30
_IMAGES_BEFORE_US = 1_300_000
_MORE_FUTURE_US = 200_000
_LEAST_LEG_US = 600_000
_SCALES = (1.0, -1.0, 0.5, -0.5)
"""How strongly a push is tried, one after another, until it is a safe one."""
_BACK_US = 2_500_000
"""How long the way back to the path takes, about."""
_SMOOTHING = 5.0
"""Samples of the recording."""


def _entries() -> dict[str, Entry]:
    ordinary = {"nominal": NOMINAL, **ORDINARY_STOPS}
    return dict(EVENTS) | {
        name: Entry(name, category, _factors_of(name), make)
        for category, makers in ordinary.items()
        for name, make in makers.items()
    }


def _factors_of(name: str) -> tuple[str, ...]:
    words = ((CURVED, "bend"), (CURVED, "curve"), (LEFT, "left_hand"))
    return tuple(factor for factor, word in words if word in name)


TRAINING_EVENTS: Mapping[str, Entry] = _entries()
"""Everything that there is to learn from, by name."""


def _groups() -> dict[str, tuple[str, ...]]:
    categories = dict.fromkeys(entry.category for entry in TRAINING_EVENTS.values())
    groups = {
        category: tuple(name for name, entry in TRAINING_EVENTS.items() if entry.category == category)
        for category in categories
    }
    # The categories of the suite take turns, each as often as it has events.
    places = {name: (index + 0.5) / len(groups[each]) for each in CATEGORIES for index, name in enumerate(groups[each])}
    return {"longtail": tuple(sorted(places, key=lambda name: places[name])), **groups}


GROUPS: Mapping[str, tuple[str, ...]] = _groups()
"""Names of events by category, and the 53 of the suite as `longtail`, whose categories take turns."""


@dataclass(frozen=True)
class Leg:
    """A part of a drive from one push to the next, or all of one that is not disturbed.

    Attributes:
        number: how many pushes there were before.
        first_us, last_us: times of its first and its last image, in the scene.
        end_us: how long its motion is known.
    """

    number: int
    first_us: int
    last_us: int
    end_us: int


def name_in_group(group: str, seed: int) -> str:
    """The event of a seed in a group: they take turns."""
    return GROUPS[group][seed % len(GROUPS[group])]


def training_scene_of(source: str) -> Scene:
    """The scene that training/NAME:SEED stands for; training/NAME is that of seed 0.

    Raises:
        InputError: there is no such event, or the seed is no number.
    """
    return make_training_scene(*name_and_seed(source, PREFIX))


def find_legs(name: str, seed: int, disturbance: Disturbance | None) -> tuple[Leg, ...]:
    """The legs of a drive, told without planning it."""
    pushes = _pushes(name, seed, disturbance)
    starts = (0, *(push.end_us - _IMAGES_BEFORE_US for push in pushes))
    ends = (*(push.begin_us for push in pushes), LAST_IMAGE_US)
    return tuple(
        Leg(number, first, last, min(last + int(FUTURE_OFFSETS_US[-1]) + _MORE_FUTURE_US, DURATION_US))
        for number, (first, last) in enumerate(zip(starts, ends, strict=True))
    )


def make_training_scene(name: str, seed: int, disturbance: Disturbance | None = None, leg: int = 0) -> Scene:
    """The scene of an event and seed with the drive of a leg; the same arguments give the same scene.

    Raises:
        InputError: there is no such event, or no clean drive through it was found.
    """
    entry, end_us = _find(name), find_legs(name, seed, disturbance)[leg].end_us
    event, _ = _event(entry, seed)
    driven = _drive_to(entry, seed, disturbance, leg)
    times = np.arange(0, end_us + 1, SAMPLE_US, dtype=np.int64)
    x, y, yaw = joined((driven.poses, driven.drive.poses(times[len(driven.poses[0]) :])))
    if leg:
        x, y, yaw = (_smoothed(each) for each in (x, y, np.unwrap(yaw)))
    label = f"training_{name}_{seed}" + (f"_leg_{leg}" if disturbance else "")
    factors = factors_of_leg(name, find_legs(name, seed, disturbance)[leg])
    return scene_of_event(label, entry.category, factors, event, Trajectory(times, planar_pose(x, y, yaw)))


def factors_of_leg(name: str, leg: Leg) -> tuple[str, ...]:
    """The scene factors of a leg: those of its event, and RECOVERY behind a push."""
    return (*_find(name).factors, RECOVERY) if leg.number else _find(name).factors


def _smoothed(values: Array) -> Array:
    """Values (n,) without the corners that a vehicle does not take where a plan begins; both ends go straight on."""
    more = 4 * round(_SMOOTHING)
    return gaussian_filter1d(np.pad(values, more, mode="reflect", reflect_type="odd"), _SMOOTHING)[more:-more]


def training_event(name: str, seed: int, attempt: int = 0) -> Event:
    """The event of a seed as it is drawn the first time, or again; nobody has driven through it yet.

    Raises:
        InputError: there is no such event.
        ValueError: ways that should meet do not.
    """
    return _find(name).make(TrainingRoads(derive_seed("training event", name, seed, attempt)))


@dataclass(frozen=True)
class _Driven:
    """Poses x, y, yaw (n,) every SAMPLE_US from the start, and the drive that goes on from there."""

    poses: Poses
    drive: Drive


def _find(name: str) -> Entry:
    if name not in TRAINING_EVENTS:
        raise InputError(f"event {name!r} is not one of {', '.join(TRAINING_EVENTS)}")
    return TRAINING_EVENTS[name]


@lru_cache(maxsize=8)
def _pushes(name: str, seed: int, disturbance: Disturbance | None) -> tuple[Push, ...]:
    if disturbance is None:
        return ()
    return disturbance.pushes(make_generator("disturbance", name, seed), LAST_IMAGE_US - _LEAST_LEG_US)


@lru_cache(maxsize=8)
def _event(entry: Entry, seed: int) -> tuple[Event, tuple[Drive, Drive]]:
    """The event as it was drawn the first time that there is a clean drive, and the drives up to SEES_US and on."""
    for attempt in range(_ATTEMPTS):
        try:
            event = training_event(entry.name, seed, attempt)
        except ValueError:  # its ways do not meet
            continue
        truth = truth_of_event(event)
        drives = first_drives(event, truth)
        if is_clean(drives[1], truth):
            return event, drives
    raise InputError(
        f"training event {entry.name}, seed {seed}: no clean drive in {_ATTEMPTS} tries; take another seed"
    )


@lru_cache(maxsize=16)
def _drive_to(entry: Entry, seed: int, disturbance: Disturbance | None, leg: int) -> _Driven:
    """What is driven up to the end of the push before a leg, and how it goes on."""
    event, (before, after) = _event(entry, seed)
    if leg == 0:
        return _Driven(before.poses(np.arange(0, SEES_US, SAMPLE_US, dtype=np.int64)), after)
    push, driven = _pushes(entry.name, seed, disturbance)[leg - 1], _drive_to(entry, seed, disturbance, leg - 1)
    end_us = find_legs(entry.name, seed, disturbance)[leg].end_us
    truth = replace(truth_of_event(event), end_us=end_us + BEYOND_US)
    planned = driven.drive.poses(np.arange(SAMPLE_US * len(driven.poses[0]), push.begin_us, SAMPLE_US, dtype=np.int64))
    pushed, drive = _push(truth, push, driven.drive)
    return _Driven(joined((driven.poses, planned, pushed)), drive)


def _push(truth: Truth, push: Push, drive: Drive) -> tuple[Poses, Drive]:
    """The poses of a push without its end, and the drive from there: as pushed, or weaker where that is not clean.

    Where none that misjudges the way is clean it is judged rightly. Where nothing else is clean the vehicle is not
    pushed, and its drive is planned anew all the same.
    """
    times = push.times(SAMPLE_US)
    for base in (misjudged_drive(truth, push, drive), drive) if push.misjudged else (drive,):
        for scale in _SCALES:
            poses = push.scaled(scale).move(base, times)
            if not (is_gentle(times, poses) and is_free(truth, times, poses)):
                continue
            found = _plan_on(truth, push, times, poses)
            back = np.arange(push.end_us, push.end_us + _BACK_US, SAMPLE_US, dtype=np.int64)
            if is_clean(found, truth) and is_gentle(back, found.poses(back)):
                return _without_last(poses), found
    poses = push.scaled(0.0).move(drive, times)
    return _without_last(poses), _plan_on(truth, push, times, poses)


def _plan_on(truth: Truth, push: Push, times: NDArray[np.int64], poses: Poses) -> Drive:
    x, y, yaw = (float(each[-1]) for each in poses)
    return plan_drive(truth, push.end_us, x, y, speed_at(poses, times), yaw)


def _without_last(poses: Poses) -> Poses:
    x, y, yaw = poses
    return x[:-1], y[:-1], yaw[:-1]
