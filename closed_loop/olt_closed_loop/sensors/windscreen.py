"""What a camera behind a windscreen sees besides the road: bonnet, reflections, drops, streaks of rain, the wiper."""

from dataclasses import dataclass

import cv2
import numpy as np

from olt_closed_loop.sensors.textures import FloatImage, Image
from olt_generator.errors import InputError
from olt_generator.seeds import make_generator

_MOST_DROPS, _MOST_STREAKS = 160, 260
_WIPE_SECONDS = 0.5
_UNWIPED_SECONDS = 6.0


@dataclass(frozen=True)
class Windscreen:
    """What is on and in the glass.

    Attributes:
        bonnet: share of the picture's height that the bonnet covers in the middle; it stays where it is.
        reflection: strength of the dashboard's reflection in the glass, 0 ... 1; it stays where it is, too.
        drops: how many drops gather on the glass, 0 ... 1.
        wiper_seconds: time from one wipe to the next, which takes the drops away; None without wiping.
        streaks: how much rain falls through the picture, 0 ... 1.

    Raises:
        InputError: a share lies outside 0 ... 1, or the time is not positive.
    """

    bonnet: float = 0.0
    reflection: float = 0.0
    drops: float = 0.0
    wiper_seconds: float | None = None
    streaks: float = 0.0

    def __post_init__(self) -> None:
        for name in ("bonnet", "reflection", "drops", "streaks"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"windscreen: {name} {getattr(self, name)}; give 0 to 1")
        if self.wiper_seconds is not None and not self.wiper_seconds > 0.0:
            raise InputError(f"windscreen: wiper every {self.wiper_seconds} s; give more than 0")


class WindscreenGlass:
    """A windscreen before a camera with pictures of a height and width, in surroundings of a light that is 1 by day."""

    def __init__(self, windscreen: Windscreen, size: tuple[int, int], light: float, seed: int) -> None:
        self._windscreen, self._seed, self._light = windscreen, seed, light
        self._height, self._width = size
        self._reflected = windscreen.reflection * self._light * _dashboard(self._height, self._width, seed)
        self._bonnet, self._covered = _bonnet(self._height, self._width, windscreen.bonnet, self._light)

    def look_through(self, image: Image, time_us: int) -> Image:
        """The image (H, W, 3), seen through the glass at a time in microseconds."""
        time = time_us * 1e-6
        seen = image.astype(np.float32)
        if self._windscreen.bonnet > 0.0:
            seen += (self._bonnet - seen) * self._covered[..., None]
        if self._windscreen.streaks > 0.0:
            seen += self._streaks(time_us)[..., None]
        if self._windscreen.reflection > 0.0:
            seen += self._reflected
        if self._windscreen.drops > 0.0:
            seen = self._refract(seen, time)
        if self._windscreen.wiper_seconds is not None:
            seen *= self._wiper(time)[..., None]
        return np.clip(seen + np.float32(0.5), 0.0, 255.0).astype(np.uint8)

    def _streaks(self, time_us: int) -> FloatImage:
        """Light (H, W) of falling drops, drawn out by the exposure."""
        generator = make_generator("streaks", self._seed, time_us)
        count = round(self._windscreen.streaks * _MOST_STREAKS)
        canvas = np.zeros((self._height, self._width), dtype=np.float32)
        x, y = generator.uniform(0.0, 1.0, (2, count)) * [[self._width], [self._height]]
        length = self._height * generator.uniform(0.02, 0.10, count)
        # Seen from a moving car rain flies apart from the middle.
        slant = 0.35 * (x / self._width - 0.5) + generator.normal(0.0, 0.03, count)
        strength = generator.uniform(6.0, 28.0, count) * self._light
        ends = np.round(np.stack([x, y, x + slant * length, y + length], axis=-1)).astype(int)
        for (x0, y0, x1, y1), light in zip(ends.tolist(), strength.tolist(), strict=True):
            cv2.line(canvas, (x0, y0), (x1, y1), light, 1)
        return np.asarray(cv2.GaussianBlur(canvas, (0, 0), 0.6), dtype=np.float32)

    def _refract(self, seen: FloatImage, time: float) -> FloatImage:
        """The picture with drops: each shows the scene around it upside down, dark at its upper rim."""
        columns, rows = (
            axis.astype(np.float32) for axis in np.meshgrid(np.arange(self._width), np.arange(self._height))
        )
        shade = np.ones((self._height, self._width), dtype=np.float32)
        for x, y, radius in self._drops(time):
            left, top = max(int(x - radius), 0), max(int(y - radius), 0)
            area = slice(top, int(y + radius) + 2), slice(left, int(x + radius) + 2)
            dx, dy = columns[area] - np.float32(x), rows[area] - np.float32(y)
            inside = dx * dx + dy * dy < radius * radius
            columns[area] = np.where(inside, x - 4.0 * dx, columns[area])
            rows[area] = np.where(inside, y - 4.0 * dy, rows[area])
            shade[area] = np.where(inside, 0.85 + 0.25 * dy / radius, shade[area])
        bent = cv2.remap(seen, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        drop = (shade != 1.0).astype(np.float32)
        soft = cv2.GaussianBlur(drop, (0, 0), 0.8)[..., None]
        blurred = cv2.blur(bent, (3, 3)) * shade[..., None]
        return seen + (blurred - seen) * soft

    def _drops(self, time: float) -> list[tuple[float, float, float]]:
        """Column, row and radius of the drops on the glass: those that fell since the last wipe."""
        period = self._windscreen.wiper_seconds
        wipe = 0 if period is None else int(time // period)
        share = 1.0 if period is None else (time % period) / period
        fresh = 1.0 if period is None else min(1.0, period / _UNWIPED_SECONDS)
        generator = make_generator("drops", self._seed, wipe)
        count = round(self._windscreen.drops * _MOST_DROPS * fresh)
        fell = generator.uniform(0.0, 1.0, count)
        x, y = generator.uniform(0.0, 1.0, (2, count)) * [[self._width], [self._height]]
        radius = self._width / 640 * np.clip(generator.lognormal(1.3, 0.5, count), 1.5, 14.0)
        there = fell <= share
        return list(zip(x[there].tolist(), y[there].tolist(), radius[there].tolist(), strict=True))

    def _wiper(self, time: float) -> FloatImage:
        """Share of light (H, W) that the wiper's blade lets through."""
        period = self._windscreen.wiper_seconds or np.inf
        moved = (time % period) / _WIPE_SECONDS
        light = np.ones((self._height, self._width), dtype=np.float32)
        if moved >= 1.0:
            return light
        # There and back from the left end to the right one, about a pivot below the picture.
        angle = np.radians(150.0 - 120.0 * (1.0 - np.cos(2.0 * np.pi * moved)) / 2.0)
        pivot, reach = np.array([0.5 * self._width, 1.35 * self._height]), 1.6 * self._height
        tip = pivot + reach * np.array([np.cos(angle), -np.sin(angle)])
        ends = [tuple(np.round(point).astype(int).tolist()) for point in (pivot, tip)]
        cv2.line(light, ends[0], ends[1], 0.1, max(2, self._width // 40), cv2.LINE_AA)
        return np.asarray(cv2.blur(light, (max(1, self._width // 60), 1)), dtype=np.float32)


def _bonnet(height: int, width: int, share: float, light: float) -> tuple[FloatImage, FloatImage]:
    """Colours (H, W, 3) of a bonnet, and how much of each pixel (H, W) it covers."""
    row, column = np.mgrid[0:height, 0:width].astype(np.float32)
    aside = (column - 0.5 * width) / (0.5 * width)
    edge = height * (1.0 - share * (1.0 - 0.45 * aside**2))
    below = (row - edge) / height
    # Dark paint: sky is mirrored near the far edge, two creases run ahead.
    gloss = 92.0 * np.exp(-np.maximum(below, 0.0) / 0.05) + 34.0
    crease = 14.0 * np.exp(-(((np.abs(aside) - 0.45 - 0.5 * below) / 0.02) ** 2))
    color = (gloss + crease)[..., None] * np.array([0.92, 0.97, 1.08], dtype=np.float32) * light
    return color.astype(np.float32), np.clip(row - edge + 0.5, 0.0, 1.0).astype(np.float32)


def _dashboard(height: int, width: int, seed: int) -> FloatImage:
    """Light (H, W, 3) of things on a dashboard, mirrored in the glass."""
    generator = make_generator("dashboard", seed)
    canvas = np.zeros((height, width), dtype=np.float32)
    for _ in range(14):
        x, y = generator.uniform(0.0, 1.0, 2) * [width, height]
        w, h = generator.uniform(0.03, 0.25, 2) * [width, 0.6 * height]
        low, high = (round(x - w / 2), round(y - h / 2)), (round(x + w / 2), round(y + h / 2))
        cv2.rectangle(canvas, low, high, float(generator.uniform(15.0, 90.0)), cv2.FILLED)
    slats = np.arange(height) // max(1, height // 90) % 3 == 0
    canvas[slats & (np.arange(height) > 0.7 * height)] += 25.0
    soft = cv2.GaussianBlur(canvas, (0, 0), width / 120)
    return (soft[..., None] * np.array([1.0, 0.98, 0.95])).astype(np.float32)
