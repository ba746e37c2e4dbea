"""A data set made in memory: drives along a straight road, each with a look of its own."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from olt_generator.errors import InputError
from olt_generator.poses import planar_pose
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_toolkit.recordings.drives import Drive, Licence
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, FRONT_WIDE, POLICY_CAMERAS
from olt_toolkit.rigs.rig_files import pav_rig

WIDTH, HEIGHT = 64, 36
LICENCE = Licence("CC0", "No registration.", "Everything is allowed.")


def make_drive(key="a", images=100, rate=10.0, **changes):
    """A drive of so many images, with ego motion as long as they last and true views of the front camera alone."""
    front_us = np.rint(np.arange(images) * 1e6 / rate).astype(np.int64)
    drive = Drive(
        source="toy",
        scene_id=f"toy/{key}",
        key=key,
        front_us=front_us,
        cameras=("front",),
        ego_span_us=(0, int(front_us[-1])) if images else None,
        true_views=(FRONT_WIDE,),
        country="DE",
    )
    return replace(drive, **changes)


def film(look, front_us):
    """Images (n, H, W, 3) of a street that moves by; those of one look are of the same street, None is a grey wall."""
    if look is None:
        return np.full((len(front_us), HEIGHT, WIDTH, 3), 128, np.uint8)
    coarse = make_generator("toy street", look).integers(0, 256, (12, 64, 3), dtype=np.uint8)
    street = cv2.resize(coarse, (8 * WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    places = (front_us // 100_000) % (7 * WIDTH)
    return np.stack([street[:, place : place + WIDTH] for place in places])


@dataclass
class ToyDataset:
    """Drives by key; `broken` keys cannot be described, and `opened` and `peeked` keep what was opened and peeked at.

    `looks` tells what drives look like; by default each like no other. `damaged_us` tells by key at which time an image
    is damaged.
    """

    drives: dict[str, Drive]
    broken: tuple[str, ...] = ()
    source: str = "toy"
    licence: Licence = LICENCE
    opened: list = field(default_factory=list)
    peeked: list = field(default_factory=list)
    looks: dict = field(default_factory=dict)
    damaged_us: dict[str, int] = field(default_factory=dict)

    def keys(self):
        return sorted([*self.drives, *self.broken])

    def drive(self, key):
        if key in self.broken:
            raise InputError(f"{key}: poses are missing")
        return self.drives[key]

    def peek(self, key, times_us, width, reach_us):
        self.peeked.append((key, times_us.tolist()))
        front_us = self.drives[key].front_us
        shown_us = front_us[np.abs(front_us[:, None] - times_us).argmin(axis=0)]
        if self.damaged_us.get(key) in shown_us:
            raise InputError(f"{key}: the image at {self.damaged_us[key]} us is damaged")
        return film(self.looks.get(key, key), shown_us), shown_us

    def open(self, key, window_us, options):
        self.opened.append((key, window_us, options))
        drive = self.drives[key]
        times = drive.front_us[(drive.front_us >= window_us[0]) & (drive.front_us <= window_us[1])] - window_us[0]
        rig = pav_rig().fitted(WIDTH, HEIGHT)
        images = film(self.looks.get(key, key), times + window_us[0])
        return Recording(
            name=key,
            source="toy",
            frames=images,
            timestamps_us=times,
            camera=rig[FRONT_WIDE].camera,
            T_rig_camera=rig[FRONT_WIDE].T_rig_camera,
            vehicle=DEFAULT_VEHICLE,
            reference=None if drive.ego_span_us is None else straight_on(drive.ego_span_us, window_us[0]),
            views={name: images for name in POLICY_CAMERAS if name in drive.true_views and name in options.views},
        )


def straight_on(span_us, start_us):
    times = np.arange(span_us[0], span_us[1] + 1, 100_000) - start_us
    still = np.zeros(len(times))
    return Trajectory(times, planar_pose(5e-6 * times, still, still))


@dataclass
class ToyReader:
    """Opens the data set, whatever the folder holds."""

    dataset: ToyDataset
    name: str = "toy"
    licence: Licence = LICENCE

    def recognises(self, root: Path):
        return True

    def open(self, root: Path, cache: Path):
        return self.dataset
