"""Light and weather over a scene: they change its looks, and nothing of its geometry or motion."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from olt_closed_loop.scenes.looks import Color, Looks
from olt_generator.errors import InputError

Light = Literal["day", "low_sun", "night"]
LIGHTS: tuple[Light, ...] = ("day", "low_sun", "night")

_LOW_SUN = np.radians(7.0)
_CLEAR_HAZE, _RAIN_HAZE, _FOG_HAZE = 700.0, 180.0, 35.0
_NIGHT_SKY = (0.05, 0.052, 0.075)


@dataclass(frozen=True)
class Conditions:
    """Light and weather.

    Attributes:
        light: "day" as the looks have it; "low_sun", seven degrees high; "night", with the lamps of vehicles.
        rain: 0 (dry) ... 1 (downpour): grey sky, haze, and a wet road that mirrors.
        fog: 0 (none) ... 1 (dense: what is 35 m away is seen to 1/e), under a grey sky.
        street_lights: whether the street lights burn at night.

    Raises:
        InputError: there is no such light, or rain or fog lie outside 0 ... 1.
    """

    light: Light = "day"
    rain: float = 0.0
    fog: float = 0.0
    street_lights: bool = True

    def __post_init__(self) -> None:
        if self.light not in LIGHTS:
            raise InputError(f"light {self.light!r} is not one of {', '.join(LIGHTS)}")
        if not 0.0 <= self.rain <= 1.0:
            raise InputError(f"rain {self.rain}: give 0 (dry) to 1 (downpour)")
        if not 0.0 <= self.fog <= 1.0:
            raise InputError(f"fog {self.fog}: give 0 (none) to 1 (dense)")

    @property
    def haze_distance(self) -> float:
        """Metres in which the haze takes all but 1/e of what is seen."""
        seen = _CLEAR_HAZE * (_RAIN_HAZE / _CLEAR_HAZE) ** self.rain
        return float(seen * (_FOG_HAZE / _CLEAR_HAZE) ** self.fog)

    @property
    def sun_share(self) -> float:
        """How much of the sun comes through: 1 without rain and fog, 0 under a grey sky."""
        return max(0.0, 1.0 - 2.0 * max(self.rain, self.fog))

    @property
    def brightness(self) -> float:
        """Light of the surroundings, 1 by day."""
        return 0.08 if self.light == "night" else 1.0

    @property
    def sky_light(self) -> tuple[float, float, float]:
        """Factors of the sky's red, green and blue."""
        return _NIGHT_SKY if self.light == "night" else (1.0, 1.0, 1.0)

    @property
    def words(self) -> str:
        """Light and weather in words."""
        weather = [f"{name} {amount:g}" for name, amount in (("rain", self.rain), ("fog", self.fog)) if amount]
        return ", ".join([self.light, *(weather or ["clear"])])


CLEAR_DAY = Conditions()
WEATHERS: tuple[str, ...] = ("clear", "rain", "fog")


def parse_conditions(light: Light, weather: str) -> Conditions:
    """Conditions of a light and a weather: clear, rain, fog, or with an amount of 0 to 1 as in rain:0.3.

    Raises:
        InputError: there is no such light or weather, or the amount is none of it.
    """
    kind, colon, amount = weather.partition(":")
    if kind not in WEATHERS or (colon and kind == "clear"):
        raise InputError(f"weather {weather!r}: give clear, rain, fog, or an amount of these two as in rain:0.3")
    if kind == "clear":
        return Conditions(light)
    try:
        share = float(amount) if colon else 0.5
    except ValueError as error:
        raise InputError(f"weather {weather!r}: {amount!r} is no number") from error
    return Conditions(light, rain=share) if kind == "rain" else Conditions(light, fog=share)


def relight(looks: Looks, conditions: Conditions) -> Looks:
    """The looks under light and weather; those of a clear day are the looks themselves, and those of a night too.

    At night the colours of things stay, and the renderer's lamps light them.
    """
    if conditions.light == "low_sun":
        looks = _lower_sun(looks)
    looks = _overcast(looks, 1.0 - conditions.sun_share)
    return _wet(looks, min(1.0, 2.0 * conditions.rain))


def _overcast(looks: Looks, share: float) -> Looks:
    if share == 0.0:
        return looks
    return replace(
        looks,
        zenith=_mix(looks.zenith, (142.0, 148.0, 156.0), share),
        horizon=_mix(looks.horizon, (176.0, 180.0, 184.0), share),
        cloudiness=(1.0 - share) * looks.cloudiness,
    )


def _wet(looks: Looks, share: float) -> Looks:
    if share == 0.0:
        return looks
    return replace(
        looks,
        asphalt=_mix(looks.asphalt, (52.0, 54.0, 58.0), share),
        gravel=_mix(looks.gravel, (86.0, 80.0, 72.0), share),
    )


def _lower_sun(looks: Looks) -> Looks:
    x, y, _ = looks.sun_direction
    flat = np.cos(_LOW_SUN) / np.hypot(x, y)
    return replace(
        looks,
        sun_direction=(float(flat * x), float(flat * y), float(np.sin(_LOW_SUN))),
        zenith=_mix(looks.zenith, (96.0, 116.0, 168.0), 0.7),
        horizon=_mix(looks.horizon, (250.0, 206.0, 150.0), 0.8),
    )


def _mix(first: Color, second: Color, share: float) -> Color:
    red, green, blue = ((1.0 - share) * np.array(first) + share * np.array(second)).tolist()
    return red, green, blue
