"""The synthetic world as a data set: drives that are invented and rendered when they are opened.

The folder holds one file, `synthetic.yaml`:

    categories: [nominal, work_zone]    # of `synthetic_drives.NAMES`
    seed: 0                             # scene seed of the first drive of each category
    count: 4                            # scene seeds of each category
    duration: 14.0                      # seconds of each drive at most; may be left out
    frame_rate: 10.0                    # images per second; may be left out
    split: train                        # train, val or test; may be left out
    conditions:                         # light and weather; may be left out, as may each value
        light: night                    # day, low_sun or night
        rain: 0.6                       # 0 ... 1
        street_lights: true
    camera:                             # effects of the cameras; may be left out, as may each value
        exposure_s: 0.012               # motion blur
        readout_s: 0.02                 # rolling shutter
        noise: 4.0                      # grey levels at mid grey
        glow: 0.5                       # around lamps
        kilobits_per_second: 1500.0     # of an encoder
        bonnet: 0.15                    # this and what follows: of the front-wide camera alone
        reflection: 0.3
        drops: 0.5
        wiper_seconds: 1.5
        streaks: 0.6

Categories are those of `olt_closed_loop.scenes.procedural`, whose drives last 14 s, and drives to learn from, which
last 20 s on roads that no scene of the long-tail suite has: `training/nominal`, `training/work_zone` and so on, whose
events take turns by seed, `training/longtail` for the events of the suite, or one event as `training/wye_merge`. These
may be disturbed, and come in legs then, each a drive of its own whose history shows the push and whose future does not:

    disturbance:
        every: 4.0                      # seconds from one push to the next, on average, 4 or more
        offset: 1.0                     # metres aside at most
        angle: 6.0                      # degrees turned at most
        speed: 2.0                      # m/s too fast or too slow at most
        blind: 0.4                      # share of the pushes that go on as if nobody were there; 0 if left out
        hesitant: 0.3                   # share of the pushes that brake or stay where the way is free; 0 if left out

What the values mean: `olt_closed_loop.scenes.conditions`, `olt_closed_loop.sensors.shutter`, `imager`, `windscreen`.
Equal files give equal images. Category, scene factors, motion and all views are known exactly.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from olt_closed_loop.privileged.labels import label_holds, label_obstacles, label_road
from olt_closed_loop.scenes.conditions import CLEAR_DAY, Conditions, Light
from olt_closed_loop.scenes.procedural import DURATION_US as PROCEDURAL_US
from olt_closed_loop.sensors.camera_effects import CameraEffects
from olt_closed_loop.sensors.imager import Imager
from olt_closed_loop.sensors.recorder import image_times, record_drive
from olt_closed_loop.sensors.shutter import Shutter
from olt_closed_loop.sensors.windscreen import Windscreen
from olt_closed_loop.suite.courses import DURATION_US
from olt_closed_loop.suite.disturbances import SHORTEST_US, Disturbance
from olt_closed_loop.suite.training import PREFIX
from olt_datasets.sources.synthetic_drives import NAMES, SceneDrive, find_drives
from olt_datasets.sources.times import nearest_images
from olt_generator import InputError
from olt_toolkit import DatasetReader, Drive, Licence, OpenOptions, Recording
from olt_toolkit.clips.clip import Split
from olt_toolkit.policy.window import Span
from olt_toolkit.rigs.rig import CAMERA_INDEX, FRONT_WIDE
from olt_toolkit.rigs.rig_files import pav_rig
from olt_toolkit.runtime.yaml_files import read_yaml_mapping

NAME = "synthetic"
FILE = "synthetic.yaml"
LICENCE = Licence("Apache-2.0", "Made by the toolkit itself.", "None but those of the toolkit.")
# Shape of the images: that of the target rig's.
_ASPECT = 9 / 16
_MOST_DRIVES = 1_000_000
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class _Conditions(BaseModel):
    """Light and weather."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    light: Light = "day"
    rain: Share = 0.0
    street_lights: bool = True

    def build(self) -> Conditions:
        """The conditions of the renderer."""
        return Conditions(**self.model_dump())

    def notes(self) -> tuple[str, ...]:
        """A sentence where it is not a clear day."""
        if self.build() == CLEAR_DAY:
            return ()
        return (f"The light is that of {self.light.replace('_', ' ')}, with rain {self.rain:g} of 1.",)


class _Camera(BaseModel):
    """Effects of the cameras."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    exposure_s: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    readout_s: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    noise: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    glow: Share = 0.0
    kilobits_per_second: Annotated[float, Field(gt=0.0)] | None = None
    bonnet: Share = 0.0
    reflection: Share = 0.0
    drops: Share = 0.0
    wiper_seconds: Annotated[float, Field(gt=0.0)] | None = None
    streaks: Share = 0.0

    def build(self, names: tuple[str, ...]) -> dict[str, CameraEffects]:
        """Effects by camera: shutter, imager and encoder of all, the windscreen of the front-wide camera."""
        if self == _Camera():
            return {}
        imager = Imager(self.noise, self.glow) if self.noise > 0.0 or self.glow > 0.0 else None
        shutter = Shutter(self.exposure_s, self.readout_s)
        common = CameraEffects(shutter, None, imager, self.kilobits_per_second)
        glass = Windscreen(self.bonnet, self.reflection, self.drops, self.wiper_seconds, self.streaks)
        behind_glass = replace(common, windscreen=None if glass == Windscreen() else glass)
        return {**dict.fromkeys(names, common), FRONT_WIDE: behind_glass}


class _Disturbance(BaseModel):
    """How much drives are disturbed."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    every: Annotated[float, Field(ge=1e-6 * SHORTEST_US, le=20.0)] = 1e-6 * SHORTEST_US
    offset: Annotated[float, Field(ge=0.0, le=2.0)] = 1.0
    angle: Annotated[float, Field(ge=0.0, le=20.0)] = 6.0
    speed: Annotated[float, Field(ge=0.0, le=5.0)] = 2.0
    blind: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    hesitant: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0

    def build(self) -> Disturbance:
        """The disturbance of the drives."""
        angle = float(np.radians(self.angle))
        return Disturbance(round(1e6 * self.every), self.offset, angle, self.speed, self.blind, self.hesitant)

    @model_validator(mode="after")
    def _check_shares(self) -> Self:
        if self.blind + self.hesitant > 1.0:
            raise ValueError(f"blind and hesitant are {self.blind + self.hesitant:g} together; give at most 1")
        return self


class _Specification(BaseModel):
    """The content of `synthetic.yaml`."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    categories: Annotated[tuple[str, ...], Field(min_length=1)]
    seed: Annotated[int, Field(ge=0)]
    count: Annotated[int, Field(ge=1, le=_MOST_DRIVES)]
    duration: Annotated[float, Field(gt=0.0, le=DURATION_US * 1e-6)] | None = None
    frame_rate: Annotated[float, Field(gt=0.0, le=120.0)] = 10.0
    split: Split | None = None
    conditions: _Conditions = _Conditions()
    camera: _Camera = _Camera()
    disturbance: _Disturbance | None = None

    def drives(self) -> dict[str, SceneDrive]:
        """All drives by key."""
        until_us = None if self.duration is None else round(1e6 * self.duration)
        disturbance = None if self.disturbance is None else self.disturbance.build()
        return {
            drive.key: drive
            for name in self.categories
            for seed in range(self.seed, self.seed + self.count)
            for drive in find_drives(name, seed, until_us, disturbance)
        }

    def take(self, leg: int | None) -> str:
        """Tells drives of one scene apart that are driven or filmed in other ways; empty for the usual ones."""
        told = self.model_dump(include={"frame_rate", "conditions", "camera", "disturbance"}, exclude_defaults=True)
        told = {name: value for name, value in told.items() if value != {}} | ({} if leg is None else {"leg": leg})
        return json.dumps(told, sort_keys=True) if told else ""

    @field_validator("categories")
    @classmethod
    def _check_categories(cls, categories: tuple[str, ...]) -> tuple[str, ...]:
        unknown = [name for name in categories if name not in NAMES]
        if unknown or len(set(categories)) < len(categories):
            raise ValueError(f"give each category once, of {', '.join(NAMES)}")
        return categories

    @model_validator(mode="after")
    def _check_together(self) -> Self:
        procedural = [name for name in self.categories if not name.startswith(PREFIX)]
        if procedural and self.disturbance is not None:
            raise ValueError(f"disturbance: drives of {', '.join(procedural)} cannot be disturbed, only {PREFIX}...")
        longest = PROCEDURAL_US * 1e-6
        if procedural and self.duration is not None and self.duration > longest:
            raise ValueError(f"duration: drives of {', '.join(procedural)} last {longest:g} s; give at most that")
        return self


class Synthetic:
    """The drives that a specification asks for; see `Dataset`."""

    source = NAME
    licence = LICENCE

    def __init__(self, root: Path, _: Path) -> None:
        self._file = root / FILE
        content = read_yaml_mapping(self._file, "specification of synthetic drives", _Specification.model_fields)
        try:
            self._asked = _Specification.model_validate(content)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(part) for part in first["loc"])
            raise InputError(f"{self._file}: {place}: {first['msg']}") from error
        self._drives = self._asked.drives()

    def keys(self) -> list[str]:
        """See `Dataset.keys`: category or event, scene seed, and leg, as in `work_zone_000003`."""
        return sorted(self._drives)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; nothing is rendered."""
        found = self._find(key)
        times_us, asked = found.image_times(self._asked.frame_rate), self._asked
        motion_us = image_times(found.motion_us, asked.frame_rate)[-1]
        return Drive(
            source=NAME,
            scene_id=f"{NAME}/{found.world}",
            key=key,
            front_us=times_us - times_us[0],
            cameras=tuple(pav_rig().cameras),
            ego_span_us=(-int(times_us[0]), int(motion_us - times_us[0])),
            true_views=tuple(CAMERA_INDEX),
            category=found.category,
            factors=found.factors,
            split=asked.split,
            notes=(
                "The world is invented and its images are rendered, not filmed.",
                *asked.conditions.notes(),
            ),
            take=asked.take(found.leg.number if found.disturbance and found.leg else None),
        )

    def peek(
        self, key: str, times_us: NDArray[np.int64], width: int, reach_us: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """See `Dataset.peek`; renders just these images, without the loss of an encoder."""
        shown_us = self._find(key).image_times(self._asked.frame_rate)
        front_us = shown_us - shown_us[0]
        numbers = nearest_images(front_us, times_us)
        distinct, places = np.unique(numbers, return_inverse=True)
        effects = {
            name: replace(each, kilobits_per_second=None)
            for name, each in self._asked.camera.build((FRONT_WIDE,)).items()
        }
        recording = record_drive(
            self._find(key).scene(),
            *(width, round(width * _ASPECT)),
            self._asked.frame_rate,
            images_us=shown_us[distinct],
            effects=effects,
            renderer=self._find(key).renderer(self._asked.conditions.build()),
        )
        return recording.frames[places], front_us[numbers]

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`; lens and mounting are those of the nominal rig."""
        options.refuse_camera(f"{self._file}: drive {key}")
        found = self._find(key)
        times_us = found.image_times(self._asked.frame_rate)
        first_us, last_us = (int(times_us[0]) + each for each in window_us)
        scene = found.scene()
        recording = record_drive(
            scene,
            options.width,
            options.height or round(options.width * _ASPECT),
            self._asked.frame_rate,
            cameras=options.views,
            with_distance=options.true_distance,
            window_us=(max(first_us, int(times_us[0])), min(last_us, int(times_us[-1]))),
            effects=self._asked.camera.build(options.views),
            renderer=found.renderer(self._asked.conditions.build()),
        )
        shown_us = times_us[times_us >= first_us]
        labels = {"obstacles": label_obstacles, "holds": label_holds, "road": label_road}
        return replace(recording, **{name: label(scene, int(shown_us[0])) for name, label in labels.items()})

    def _find(self, key: str) -> SceneDrive:
        if key not in self._drives:
            raise InputError(f"{self._file}: asks for no drive {key!r}")
        return self._drives[key]


DATASET = DatasetReader(NAME, LICENCE, lambda path: (path / FILE).is_file(), Synthetic)
