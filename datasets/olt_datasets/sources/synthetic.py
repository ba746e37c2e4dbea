"""The synthetic world as a data set: drives that are invented and rendered when they are opened.

The folder holds one file, `synthetic.yaml`:

    categories: [nominal, work_zone]    # of `olt_closed_loop.scenes.procedural.CATEGORIES`
    seed: 0                             # scene seed of the first drive of each category
    count: 4                            # drives of each category
    duration: 14.0                      # seconds of each drive, up to 14; may be left out
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

What the values mean: `olt_closed_loop.scenes.conditions`, `olt_closed_loop.sensors.shutter`, `imager`, `windscreen`.
Equal files give equal images. Category, scene factors, motion and all views are known exactly.
"""

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from olt_closed_loop.scenes.conditions import CLEAR_DAY, Conditions, Light
from olt_closed_loop.scenes.procedural import CATEGORIES, DURATION_US, generate_scene
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.sensors.camera_effects import CameraEffects
from olt_closed_loop.sensors.imager import Imager
from olt_closed_loop.sensors.recorder import frame_times, record_drive
from olt_closed_loop.sensors.shutter import Shutter
from olt_closed_loop.sensors.windscreen import Windscreen
from olt_datasets.sources.times import nearest_images
from olt_generator import InputError, Trajectory
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
_generate_scene = lru_cache(maxsize=8)(generate_scene)


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


class _Specification(BaseModel):
    """The content of `synthetic.yaml`."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    categories: Annotated[tuple[str, ...], Field(min_length=1)]
    seed: Annotated[int, Field(ge=0)]
    count: Annotated[int, Field(ge=1, le=_MOST_DRIVES)]
    duration: Annotated[float, Field(gt=0.0, le=DURATION_US * 1e-6)] = DURATION_US * 1e-6
    frame_rate: Annotated[float, Field(gt=0.0, le=120.0)] = 10.0
    split: Split | None = None
    conditions: _Conditions = _Conditions()
    camera: _Camera = _Camera()

    def take(self) -> str:
        """Tells drives of one scene apart that are filmed in other ways; empty for a clear day at the usual rate."""
        told = self.model_dump(include={"frame_rate", "conditions", "camera"}, exclude_defaults=True)
        told = {name: value for name, value in told.items() if value != {}}
        return json.dumps(told, sort_keys=True) if told else ""

    @field_validator("categories")
    @classmethod
    def _check_categories(cls, categories: tuple[str, ...]) -> tuple[str, ...]:
        unknown = [name for name in categories if name not in CATEGORIES]
        if unknown or len(set(categories)) < len(categories):
            raise ValueError(f"give each category once, of {', '.join(CATEGORIES)}")
        return categories


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
        seeds = range(self._asked.seed, self._asked.seed + self._asked.count)
        self._drives = {f"{name}_{seed:06d}": (name, seed) for name in self._asked.categories for seed in seeds}

    def keys(self) -> list[str]:
        """See `Dataset.keys`: category and scene seed, `work_zone_000003`."""
        return sorted(self._drives)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; the scene is invented and nothing is rendered."""
        scene = self._scene(key)
        times_us = frame_times(scene, self._asked.frame_rate)
        return Drive(
            source=NAME,
            scene_id=f"{NAME}/{key}",
            key=key,
            front_us=times_us,
            cameras=tuple(pav_rig().cameras),
            ego_span_us=(0, int(times_us[-1])),
            true_views=tuple(CAMERA_INDEX),
            category=scene.category,
            factors=scene.factors,
            split=self._asked.split,
            notes=(
                "The world is invented and its images are rendered, not filmed.",
                *self._asked.conditions.notes(),
            ),
            take=self._asked.take(),
        )

    def peek(
        self, key: str, times_us: NDArray[np.int64], width: int, reach_us: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """See `Dataset.peek`; renders just these images, without the loss of an encoder."""
        scene = self._scene(key)
        front_us = frame_times(scene, self._asked.frame_rate)
        numbers = nearest_images(front_us, times_us)
        distinct, places = np.unique(numbers, return_inverse=True)
        effects = {
            name: replace(each, kilobits_per_second=None)
            for name, each in self._asked.camera.build((FRONT_WIDE,)).items()
        }
        recording = record_drive(
            scene,
            *(width, round(width * _ASPECT)),
            self._asked.frame_rate,
            images_us=front_us[distinct],
            conditions=self._asked.conditions.build(),
            effects=effects,
        )
        return recording.frames[places], front_us[numbers]

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`; lens and mounting are those of the nominal rig."""
        options.refuse_camera(f"{self._file}: drive {key}")
        size, scene = (options.width, round(options.width * _ASPECT)), self._scene(key)
        return record_drive(
            scene,
            *size,
            self._asked.frame_rate,
            cameras=options.views,
            with_distance=options.true_distance,
            window_us=window_us,
            conditions=self._asked.conditions.build(),
            effects=self._asked.camera.build(options.views),
        )

    def _scene(self, key: str) -> Scene:
        if key not in self._drives:
            raise InputError(f"{self._file}: asks for no drive {key!r}")
        scene = _generate_scene(*self._drives[key])
        shown = scene.ego.timestamps_us <= round(self._asked.duration * 1e6)
        return replace(scene, ego=Trajectory(scene.ego.timestamps_us[shown], scene.ego.T_world_rig[shown]))


DATASET = DatasetReader(NAME, LICENCE, lambda path: (path / FILE).is_file(), Synthetic)
