"""The kinds of hard clips, and the list on which estimates of motion are calibrated.

Every kind starts from an ordinary drive and makes one thing of it hard; the kind "mixture" makes several.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from olt_closed_loop.hard_clips.specification import (
    Bend,
    ClipSpecification,
    Course,
    FilmingCamera,
    Traffic,
)
from olt_closed_loop.scenes.conditions import Conditions
from olt_closed_loop.scenes.hills import Wave
from olt_closed_loop.scenes.roads import LANE_WIDTH
from olt_closed_loop.scenes.traffic import Lead, Stream
from olt_closed_loop.sensors.imager import Imager
from olt_closed_loop.sensors.windscreen import Windscreen
from olt_generator.camera_spread import CameraSpread, Spread
from olt_generator.errors import InputError
from olt_generator.seeds import make_generator

Generator = np.random.Generator
Change = Callable[[ClipSpecification, Generator], ClipSpecification]

_LORRIES = 0.3
_LABELS = ("automobile", "automobile", "heavy_truck")


def list_hard_clips(count: int = 200, seed: int = 0, kinds: tuple[str, ...] | None = None) -> list[ClipSpecification]:
    """Specifications of hard clips, the kinds in turn; the first ones of a longer list are the shorter list.

    Raises:
        InputError: there is no such kind, or the count is not positive.
    """
    chosen = kinds or tuple(KINDS)
    unknown = [kind for kind in chosen if kind not in KINDS]
    if unknown:
        raise InputError(f"kind {unknown[0]!r} is not one of {', '.join(KINDS)}")
    if count < 1:
        raise InputError(f"{count} hard clips asked for; give at least 1")
    return [specify_clip(chosen[index % len(chosen)], index // len(chosen), seed) for index in range(count)]


def specify_clip(kind: str, number: int, seed: int) -> ClipSpecification:
    """The clip of that number of a kind; each depends on kind, number and seed alone."""
    generator = make_generator("hard clips", seed, kind, number)
    clip = KINDS[kind](_ordinary(f"{kind}_{number:03d}_{seed}", kind, seed, generator), generator)
    return _misjudge_camera(clip, generator)


def _ordinary(name: str, kind: str, seed: int, generator: Generator) -> ClipSpecification:
    """A drive by day at an even pace with little traffic."""
    speed = generator.uniform(8.0, 20.0)
    seconds = generator.uniform(2.7, 6.0)
    rate = float(generator.choice([10.0, 12.5, 15.0, 20.0, 25.0, 30.0]))
    pitch, yaw, roll = np.radians(generator.normal([1.0, 0.0, 0.0], [1.5, 0.7, 0.3])).tolist()
    return ClipSpecification(
        name=name,
        kind=kind,
        seed=seed,
        frames=int(np.clip(round(seconds * rate), 41, 80)),
        frame_rate=rate,
        course=_at_pace(Course(bends=_gentle_bend(speed, generator)), speed, generator),
        traffic=Traffic(streams=(_oncoming(generator, 0, gap=45.0),)),
        camera=FilmingCamera(
            horizontal_fov=float(np.radians(generator.uniform(60.0, 95.0))),
            mounting_height=float(generator.uniform(1.2, 1.7)),
            pitch=pitch,
            yaw=yaw,
            roll=roll,
            stated_pitch=pitch,
            stated_yaw=yaw,
        ),
    )


def _misjudge_camera(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """Draw how far the true camera is from the stated one, from what the recording says of its spread."""
    spread = clip.camera.spread
    height, focal = generator.normal(0.0, [spread.height.relative, spread.focal_length.relative]).tolist()
    return replace(clip, camera=replace(clip.camera, height_off=height, focal_off=focal))


def _at_pace(course: Course, speed: float, generator: Generator) -> Course:
    """The course driven at about `speed`, now a little faster, now slower."""
    times = (0.0, 2.0, 4.0, 6.0, 9.0)
    speeds = speed * (1.0 + 0.1 * np.cumsum(generator.uniform(-0.6, 0.6, len(times))))
    return replace(course, times=times, speeds=tuple(speeds.tolist()))


def _gentle_bend(speed: float, generator: Generator) -> tuple[Bend, ...]:
    if generator.random() < 0.4:
        return ()
    radius = max(80.0, speed**2 / generator.uniform(0.5, 2.0))
    angle = float(generator.choice([-1.0, 1.0]) * generator.uniform(0.2, 0.8))
    return (Bend(float(generator.uniform(0.0, 25.0)), float(radius), angle, 25.0),)


def _oncoming(generator: Generator, lane: int, gap: float) -> Stream:
    return Stream((lane + 0.5) * LANE_WIDTH, float(generator.uniform(6.0, 16.0)), gap, _LORRIES)


def _beside(lane: int, speed: float, gap: float, lorries: float = _LORRIES, stops: bool = False) -> Stream:
    return Stream(-(lane + 0.5) * LANE_WIDTH, speed, gap, lorries, stops)


def make_traffic(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """Dense moving traffic on both sides and close ahead, slower and faster than the vehicle that films."""
    speed = float(generator.uniform(3.0, 22.0))
    gap = float(generator.uniform(4.0, 14.0))
    faster, slower = (float(speed + change) for change in generator.uniform([1.0, -6.0], [6.0, -0.5]))
    near, far = (faster, max(slower, 0.5)) if generator.random() < 0.5 else (max(slower, 0.5), faster)
    streams = (
        _beside(0, near, gap, 0.4),
        _beside(2, far, gap, 0.4),
        _oncoming(generator, 0, gap=15.0),
        _oncoming(generator, 1, gap=15.0),
    )
    swing = float(generator.uniform(0.0, min(4.0, 0.8 * speed)))
    lead = Lead(float(generator.uniform(5.0, 18.0)), str(generator.choice(_LABELS)), swing)
    course = _at_pace(Course(3, 1, _gentle_bend(max(speed, 8.0), generator)), speed, generator)
    return replace(clip, course=course, traffic=Traffic(lead, streams))


def make_stop_and_go(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """A jam: rolling, braking, standing and pulling away between lanes that do the same at other times."""
    top = float(generator.uniform(2.0, 7.0))
    times, speeds = (0.0, 1.3, 2.2, 3.2, 4.6, 6.0, 9.0), np.array([1.0, 0.4, 0.0, 0.0, 0.7, 1.0, 0.6])
    if generator.random() < 0.5:
        speeds = speeds[::-1]
    streams = (
        _beside(0, float(generator.uniform(2.0, 8.0)), 4.0, 0.4, stops=True),
        _beside(2, float(generator.uniform(2.0, 8.0)), 4.0, 0.4, stops=True),
        _oncoming(generator, 0, gap=12.0),
    )
    lead = Lead(float(generator.uniform(3.0, 7.0)), str(generator.choice(_LABELS)))
    course = Course(3, 1, (), times, tuple((top * speeds).tolist()))
    return replace(clip, frames=80, course=course, traffic=Traffic(lead, streams))


def make_standstill(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """The vehicle stands while others pass on both sides and the one ahead may pull away."""
    streams = (
        _beside(0, float(generator.uniform(1.0, 12.0)), 6.0, 0.4),
        _beside(2, float(generator.uniform(1.0, 12.0)), 6.0, 0.4),
        _oncoming(generator, 0, gap=15.0),
    )
    pulls_away = float(generator.choice([0.0, 1.0, 2.0]))
    lead = Lead(float(generator.uniform(3.0, 10.0)), str(generator.choice(_LABELS)), pulls_away=pulls_away)
    course = Course(3, 1, (), (0.0, 10.0), (0.0, 0.0))
    return replace(clip, course=course, traffic=Traffic(lead, streams))


def make_turn(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """A motorway ramp of a quarter turn and more, or a turn at a junction."""
    side = float(generator.choice([-1.0, 1.0]))
    if generator.random() < 0.5:
        radius = float(generator.uniform(28.0, 60.0))
        angle = side * float(np.radians(generator.uniform(80.0, 150.0)))
        speed = float(np.sqrt(generator.uniform(2.0, 3.5) * radius))
        bend = Bend(float(generator.uniform(-10.0, 8.0)), radius, angle, 20.0)
        course = Course(1, 0, (bend,))
        return replace(clip, frames=80, course=_at_pace(course, speed, generator), traffic=Traffic())
    radius = float(generator.uniform(9.0, 14.0))
    speed = float(np.sqrt(generator.uniform(1.5, 3.0) * radius))
    bend = Bend(float(generator.uniform(0.0, 10.0)), radius, side * np.pi / 2, 5.0)
    course = Course(1, 0, (bend,), crossing=bend.after)
    return replace(clip, frames=80, course=_at_pace(course, speed, generator), traffic=Traffic())


def make_night(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """Night, with or without street lights, with the lamps of others and the noise of a camera that sees little."""
    streams = (*clip.traffic.streams, _beside(0, float(generator.uniform(8.0, 18.0)), 35.0))
    lit = bool(generator.random() < 0.6)
    imager = Imager(noise=float(generator.uniform(3.0, 9.0)), glow=float(generator.uniform(0.3, 1.0)))
    shutter = replace(clip.effects.shutter, exposure_s=float(generator.uniform(0.008, 0.025)), samples=3)
    return replace(
        clip,
        traffic=Traffic(streams=streams),
        conditions=Conditions("night", clip.conditions.rain, lit),
        effects=replace(clip.effects, imager=imager, shutter=shutter),
    )


def make_rain(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """Rain on road, in the air and on the glass, with and without a wiper."""
    streams = (*clip.traffic.streams, _beside(0, float(generator.uniform(8.0, 18.0)), 35.0))
    rain = float(generator.uniform(0.3, 1.0))
    windscreen = Windscreen(
        drops=float(generator.uniform(0.3, 1.0)),
        wiper_seconds=float(generator.uniform(0.9, 3.0)) if generator.random() < 0.7 else None,
        streaks=rain,
    )
    return replace(
        clip,
        traffic=Traffic(streams=streams),
        conditions=replace(clip.conditions, rain=rain),
        effects=replace(clip.effects, windscreen=windscreen),
    )


def make_bonnet(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """The bonnet in the picture, and reflections in the windscreen."""
    reflection = float(generator.uniform(0.2, 0.7)) if generator.random() < 0.7 else 0.0
    windscreen = Windscreen(bonnet=float(generator.uniform(0.10, 0.28)), reflection=reflection)
    return replace(clip, effects=replace(clip.effects, windscreen=windscreen))


def make_rolling_shutter(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """Rows that are read out one after the other over most of the time of a frame."""
    readout = float(generator.uniform(0.015, 0.033))
    return replace(clip, effects=replace(clip.effects, shutter=replace(clip.effects.shutter, readout_s=readout)))


def make_blur(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """Long exposures."""
    exposure = float(min(generator.uniform(0.012, 0.04), 0.9 / clip.frame_rate))
    shutter = replace(clip.effects.shutter, exposure_s=exposure, samples=5)
    return replace(clip, effects=replace(clip.effects, shutter=shutter))


def make_compression(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """An encoder that has 0.03 to 0.15 bits for a pixel."""
    bits = generator.uniform(0.03, 0.15) * clip.camera.width * clip.camera.height * clip.frame_rate
    return replace(clip, effects=replace(clip.effects, kilobits_per_second=float(bits / 1000.0)))


def make_low_sun(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """A low sun, with long shadows."""
    return replace(clip, conditions=Conditions("low_sun"))


def make_hills(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """Crests and dips, up to about 9 % steep."""
    lengths = generator.uniform([80.0, 200.0], [160.0, 400.0])
    steepest = generator.uniform([0.02, 0.02], [0.045, 0.045])
    heights, phases = steepest * lengths / (2.0 * np.pi), generator.uniform(0.0, 2.0 * np.pi, 2)
    waves = tuple(Wave(*values) for values in np.column_stack([heights, lengths, phases]).tolist())
    direction = float(generator.uniform(-0.6, 0.6))
    return replace(clip, course=replace(clip.course, waves=waves, hill_direction=direction))


def make_narrow_lens(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """A lens of about 30 degrees."""
    camera = replace(
        clip.camera, horizontal_fov=float(np.radians(generator.uniform(26.0, 38.0))), pitch=0.01, stated_pitch=0.01
    )
    return replace(clip, camera=camera)


def make_wide_lens(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """A lens of 110 to 150 degrees that maps angles evenly."""
    fov = float(np.radians(generator.uniform(110.0, 150.0)))
    return replace(clip, camera=replace(clip.camera, horizontal_fov=fov, fisheye=True))


def make_unknown_camera(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """A camera of which little is known: height and field of view as well as the recording says, and where it looks."""
    spread = CameraSpread(
        Spread(float(generator.uniform(0.03, 0.12)), "assumed"), Spread(float(generator.uniform(0.02, 0.10)), "assumed")
    )
    pitch, yaw = generator.normal([clip.camera.pitch, clip.camera.yaw], np.radians(1.0)).tolist()
    return replace(clip, camera=replace(clip.camera, spread=spread, stated_pitch=pitch, stated_yaw=yaw))


def make_reverse(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """Backwards at the speed of parking, between parked cars."""
    speed = float(generator.uniform(0.7, 2.5))
    course = Course(1, 0, (), (0.0, 1.5, 5.0, 9.0), (-0.5 * speed, -speed, -speed, -0.3 * speed))
    return replace(clip, frames=80, course=course, traffic=Traffic(parked=True))


def make_mixture(clip: ClipSpecification, generator: Generator) -> ClipSpecification:
    """Several of the others together: a drive, a sky, a lens and a camera."""
    drives = (make_traffic, make_stop_and_go, make_turn, make_hills)
    skies = (make_night, make_rain, make_low_sun)
    lenses = (make_narrow_lens, make_wide_lens, make_unknown_camera)
    cameras = (make_rolling_shutter, make_blur, make_compression)
    for group in (skies, lenses, cameras, drives):
        if generator.random() < 0.75:
            clip = group[generator.integers(len(group))](clip, generator)
    return clip


KINDS: dict[str, Change] = {
    "traffic": make_traffic,
    "stop_and_go": make_stop_and_go,
    "standstill": make_standstill,
    "turn": make_turn,
    "night": make_night,
    "rain": make_rain,
    "low_sun": make_low_sun,
    "bonnet": make_bonnet,
    "rolling_shutter": make_rolling_shutter,
    "blur": make_blur,
    "compression": make_compression,
    "hills": make_hills,
    "narrow_lens": make_narrow_lens,
    "wide_lens": make_wide_lens,
    "unknown_camera": make_unknown_camera,
    "reverse": make_reverse,
    "mixture": make_mixture,
}
