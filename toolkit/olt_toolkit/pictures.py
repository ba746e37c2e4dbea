"""Pictures of clips for people."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.files import write_whole

Image = NDArray[np.uint8]

# Invented pixels are shown with this colour (RGB) mixed in.
INVENTED_TINT = (255, 0, 160)
_TINT_SHARE = 0.45
_GAP = 4
_CAPTION_HEIGHT = 22
_TEXT_COLOUR = (240, 240, 240)


def contact_sheet(
    images: Mapping[str, Image],
    observed: Mapping[str, NDArray[np.bool_]],
    timestamps_us: NDArray[np.int64],
    columns: int = 5,
    tile_width: int = 288,
) -> Image:
    """All views of a clip at a few times, invented pixels tinted.

    Args:
        images: (n, H, W, 3) uint8 by view name, one size each.
        observed: (n, H, W) pixels that are not invented, for the views that have such.
        timestamps_us: (n,) clip times of the images.
        columns: number of times, spread evenly from the first to the last.
        tile_width: width of one picture in pixels.

    Returns:
        One picture (H, W, 3): a row for each view, a column for each time.
    """
    indices = np.linspace(0, len(timestamps_us) - 1, min(columns, len(timestamps_us))).round().astype(int)
    times = [f"{timestamps_us[index] / 1e6:.1f} s" for index in indices]
    rows = [_caption(times, tile_width)]
    for name, frames in images.items():
        mask = observed.get(name)
        title = name if mask is None else f"{name}: {100 * (1 - mask.mean()):.0f} % invented (tinted)"
        tiles = [tint_invented(frames[index], None if mask is None else mask[index]) for index in indices]
        rows += [_caption([title], len(indices) * tile_width), _side_by_side(tiles, tile_width)]
    return np.concatenate(rows)


def tint_invented(image: Image, observed: NDArray[np.bool_] | None) -> Image:
    """The image (H, W, 3) with the pixels that are not observed (H, W) tinted."""
    if observed is None:
        return image
    tinted = (1.0 - _TINT_SHARE) * image + _TINT_SHARE * np.array(INVENTED_TINT)
    return np.where(observed[..., None], image, tinted).astype(np.uint8)


def write_picture(path: Path, picture: Image) -> None:
    """Write an RGB picture (H, W, 3) in the format of the path's suffix; the file appears whole."""
    with write_whole(path) as temporary:
        cv2.imwrite(str(temporary), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))


def _caption(texts: Sequence[str], width: int) -> Image:
    """A strip of texts, each at the left of its part of `width` pixels."""
    strip = np.zeros((_CAPTION_HEIGHT, len(texts) * width, 3), np.uint8)
    for index, text in enumerate(texts):
        place = (index * width + 4, _CAPTION_HEIGHT - 7)
        cv2.putText(strip, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, _TEXT_COLOUR, 1, cv2.LINE_AA)
    return strip


def _side_by_side(tiles: Sequence[Image], width: int) -> Image:
    """Pictures of one size scaled to `width` pixels, a dark line on the right of each."""
    height = max(1, round(tiles[0].shape[0] * width / tiles[0].shape[1]))
    row = [cv2.resize(tile, (width, height), interpolation=cv2.INTER_AREA) for tile in tiles]
    for tile in row:
        tile[:, -_GAP:] = 0
    return np.concatenate(row, axis=1, dtype=np.uint8)
