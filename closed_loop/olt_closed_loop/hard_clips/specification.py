"""What one hard clip shows, as plain values: equal specifications give equal clips."""

from dataclasses import dataclass, field

from olt_closed_loop.scenes.conditions import CLEAR_DAY, Conditions
from olt_closed_loop.scenes.hills import Wave
from olt_closed_loop.scenes.traffic import Lead, Stream
from olt_closed_loop.sensors.camera_effects import NO_EFFECTS, CameraEffects
from olt_generator.camera_spread import CameraSpread


@dataclass(frozen=True)
class Bend:
    """A bend of a road.

    Attributes:
        after: metres from where the vehicle starts to where the bend does.
        radius: metres, of the line between both directions of traffic.
        angle: radians, positive to the left.
        easing: metres over which the curvature grows and shrinks.
    """

    after: float
    radius: float
    angle: float
    easing: float = 15.0


@dataclass(frozen=True)
class Course:
    """The road and how the vehicle drives on it.

    Attributes:
        lanes: in each direction.
        lane: that of the vehicle; 0 is the one beside the oncoming traffic.
        bends: in the order in which they come.
        times, speeds: seconds and m/s of the drive, straight between them; negative speeds drive backwards.
        waves: of the ground along `hill_direction`, radians from the direction of the start; none on level ground.
        crossing: metres from the start to a straight road across, at a junction; None without.
    """

    lanes: int = 2
    lane: int = 1
    bends: tuple[Bend, ...] = ()
    times: tuple[float, ...] = (0.0, 10.0)
    speeds: tuple[float, ...] = (12.0, 12.0)
    waves: tuple[Wave, ...] = ()
    hill_direction: float = 0.0
    crossing: float | None = None


@dataclass(frozen=True)
class Traffic:
    """Who else is on the road; streams name their lane by its offset."""

    lead: Lead | None = None
    streams: tuple[Stream, ...] = ()
    parked: bool = False


@dataclass(frozen=True)
class FilmingCamera:
    """The camera as the recording states it, and how far the true one is off.

    Attributes:
        width, height: pixels.
        horizontal_fov: radians, as stated.
        fisheye: whether the lens maps angles evenly, as wide lenses do, or is a pinhole.
        mounting_height: metres above the road, as stated.
        pitch, yaw, roll: radians, of the true mounting (`camera_pose_in_rig`).
        stated_pitch, stated_yaw: radians, as stated.
        spread: what the recording says of how well it knows height and focal length.
        height_off, focal_off: natural logarithm of true over stated; drawn from `spread`.
    """

    width: int = 576
    height: int = 324
    horizontal_fov: float = 1.2
    fisheye: bool = False
    mounting_height: float = 1.4
    pitch: float = 0.0
    yaw: float = 0.0
    roll: float = 0.0
    stated_pitch: float = 0.0
    stated_yaw: float = 0.0
    spread: CameraSpread = field(default_factory=CameraSpread)
    height_off: float = 0.0
    focal_off: float = 0.0


@dataclass(frozen=True)
class ClipSpecification:
    """One hard clip.

    Attributes:
        name: unique in a list.
        kind: what makes it hard; one of `kinds.KINDS`.
        seed: of what is drawn while it is made: where vehicles stand in their lanes, noise, drops.
        frames: number of frames.
        frame_rate: frames per second.
    """

    name: str
    kind: str
    seed: int
    frames: int = 61
    frame_rate: float = 15.0
    course: Course = Course()
    traffic: Traffic = Traffic()
    camera: FilmingCamera = FilmingCamera()
    conditions: Conditions = CLEAR_DAY
    effects: CameraEffects = NO_EFFECTS
