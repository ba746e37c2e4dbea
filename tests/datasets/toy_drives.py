"""A data set made in memory: drives along a straight road, with flat grey images."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from olt_generator.errors import InputError
from olt_generator.poses import planar_pose
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


@dataclass
class ToyDataset:
    """Drives by key; `broken` keys cannot be described, and `opened` keeps what was opened."""

    drives: dict[str, Drive]
    broken: tuple[str, ...] = ()
    source: str = "toy"
    licence: Licence = LICENCE
    opened: list = field(default_factory=list)

    def keys(self):
        return sorted([*self.drives, *self.broken])

    def drive(self, key):
        if key in self.broken:
            raise InputError(f"{key}: poses are missing")
        return self.drives[key]

    def open(self, key, window_us, options):
        self.opened.append((key, window_us, options))
        drive = self.drives[key]
        times = drive.front_us[(drive.front_us >= window_us[0]) & (drive.front_us <= window_us[1])] - window_us[0]
        rig = pav_rig().fitted(WIDTH, HEIGHT)
        grey = np.full((len(times), HEIGHT, WIDTH, 3), 128, np.uint8)
        return Recording(
            name=key,
            source="toy",
            frames=grey,
            timestamps_us=times,
            camera=rig[FRONT_WIDE].camera,
            T_rig_camera=rig[FRONT_WIDE].T_rig_camera,
            vehicle=DEFAULT_VEHICLE,
            reference=None if drive.ego_span_us is None else straight_on(drive.ego_span_us, window_us[0]),
            views={name: grey for name in POLICY_CAMERAS if name in drive.true_views and name in options.views},
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
