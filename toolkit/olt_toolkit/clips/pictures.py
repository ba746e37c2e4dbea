"""Pictures of clips for people."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.files import write_whole
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.rigs import rig

Image = NDArray[np.uint8]

# Invented pixels are shown with this colour (RGB) mixed in, or under lines of it; unseen ones under lines of the other.
INVENTED_TINT = (255, 0, 160)
UNSEEN_LINES = (90, 90, 90)
_TINT_SHARE = 0.45
_LINE_SPACING, _LINE_WIDTH = 14, 2
_GAP = 4
_CAPTION_HEIGHT = 22
_TEXT_COLOUR = (240, 240, 240)

# Where the views stand in a preview: as the driver would look around.
_PLACES = (
    (rig.CROSS_LEFT, rig.FRONT_WIDE, rig.CROSS_RIGHT),
    (rig.FRONT_TELE,),
    (rig.REAR_LEFT, rig.REAR_TELE, rig.REAR_RIGHT),
)
_PREVIEW_RATE = 5.0
_PREVIEW_TILE = 288
_PREVIEW_QUALITY = 60


def picture_name(name: str, clip_id: str) -> str:
    """What the pictures of a clip are called: two clips of one name do not share them."""
    return f"{name}-{clip_id[:8]}"


def write_clip_pictures(
    folder: Path,
    name: str,
    images: Mapping[str, Image],
    origins: Mapping[str, NDArray[np.uint8]],
    timestamps_us: NDArray[np.int64],
) -> dict[str, str]:
    """Write a contact sheet and then an animated preview of images (n, H, W, 3); see `contact_sheet` for the rest.

    Returns:
        The paths of both, "contact_sheet" and "animation".
    """
    sheet, animation = folder / f"{name}.png", animation_path(folder, name)
    write_picture(sheet, contact_sheet(images, origins, timestamps_us))
    write_animation(animation, *preview(images, origins, timestamps_us))
    return {"contact_sheet": str(sheet), "animation": str(animation)}


def animation_path(folder: Path, name: str) -> Path:
    """Where the animated preview lies that `write_clip_pictures` writes under that name."""
    return folder / f"{name}.webp"


def contact_sheet(
    images: Mapping[str, Image],
    origins: Mapping[str, NDArray[np.uint8]],
    timestamps_us: NDArray[np.int64],
    columns: int = 5,
    tile_width: int = 288,
) -> Image:
    """All views of a clip at a few times, invented pixels tinted, unseen ones hatched: one picture (H, W, 3).

    Args:
        images: (n, H, W, 3) uint8 by view name, one size each; each is a row.
        origins: (n, H, W) a `PixelOrigin` per pixel, for the views that were not seen whole.
        timestamps_us: (n,) clip times of the images.
        columns: number of times, spread evenly from the first to the last.
        tile_width: pixels.
    """
    indices = np.linspace(0, len(timestamps_us) - 1, min(columns, len(timestamps_us))).round().astype(int)
    times = [f"{timestamps_us[index] / 1e6:.1f} s" for index in indices]
    rows: dict[str, list[Image]] = {}
    for name, frames in images.items():
        origin = origins.get(name)
        title, tiles = name, [frames[index] for index in indices]
        if origin is not None:
            title += _share_text(origin, PixelOrigin.INVENTED, "invented (tinted)")
            title += _share_text(origin, PixelOrigin.UNSEEN, "not seen (hatched)")
            tiles = [tint_invented(frames[index], origin[index]) for index in indices]
        rows[title] = tiles
    return table_of_pictures(times, rows, tile_width)


def table_of_pictures(heads: Sequence[str], rows: Mapping[str, Sequence[Image]], tile_width: int = 288) -> Image:
    """Rows of images (H, W, 3) of one size under their titles, and below the heads of their columns: one picture."""
    table = [_caption(list(heads), tile_width)]
    for title, tiles in rows.items():
        table += [_caption([title], len(heads) * tile_width), _side_by_side(list(tiles), tile_width)]
    return np.concatenate(table)


def preview(
    images: Mapping[str, Image],
    origins: Mapping[str, NDArray[np.uint8]],
    timestamps_us: NDArray[np.int64],
    tile_width: int = _PREVIEW_TILE,
) -> tuple[Image, float]:
    """All views of a clip, side by side where their cameras look, what is invented or unseen hatched.

    Images (n, H, W, 3) and origins (n, H, W) are those of `contact_sheet`, at clip times (n,).

    Returns:
        Frames (m, h, w, 3), about five a second, and how many a second show the clip as fast as it was.
    """
    seconds = float(timestamps_us[-1] - timestamps_us[0]) * 1e-6
    count = min(len(timestamps_us), max(1, round(seconds * _PREVIEW_RATE)))
    indices = np.linspace(0, len(timestamps_us) - 1, count).round().astype(int)
    frames = []
    for index in indices:
        shown = {
            name: hatch(images[name][index], origins[name][index]) if name in origins else images[name][index]
            for name in images
        }
        frames.append(_surround(shown, tile_width))
    return np.stack(frames), (count - 1) / seconds if count > 1 else 1.0


def tint_invented(image: Image, origin: NDArray[np.uint8]) -> Image:
    """The image (H, W, 3) with the pixels tinted whose origin (H, W) is invented, and the unseen ones hatched."""
    tinted = (1.0 - _TINT_SHARE) * image + _TINT_SHARE * np.array(INVENTED_TINT)
    marked = np.where((origin == PixelOrigin.INVENTED)[..., None], tinted, image).astype(np.uint8)
    return hatch(marked, np.where(origin == PixelOrigin.UNSEEN, origin, PixelOrigin.SAME_FRAME))


def hatch(image: Image, origin: NDArray[np.uint8]) -> Image:
    """The image (H, W, 3) with thin lines over the pixels whose origin (H, W) is invented, and over the unseen ones."""
    row, column = np.indices(origin.shape)
    on_line = (row + column) % _LINE_SPACING < _LINE_WIDTH
    marked = image.copy()
    marked[on_line & (origin == PixelOrigin.INVENTED)] = INVENTED_TINT
    marked[on_line & (origin == PixelOrigin.UNSEEN)] = UNSEEN_LINES
    return marked


def _share_text(origin: NDArray[np.uint8], wanted: PixelOrigin, words: str) -> str:
    share = float((origin == wanted).mean())
    return f": {100 * share:.0f} % {words}" if share else ""


def write_picture(path: Path, picture: Image) -> None:
    """Write an RGB picture (H, W, 3) in the format of the path's suffix; the file appears whole."""
    coded, content = cv2.imencode(path.suffix, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    assert coded, f"OpenCV does not write {path.suffix} pictures of shape {picture.shape}"
    with write_whole(path) as temporary:
        temporary.write_bytes(content.tobytes())


def write_animation(path: Path, frames: Image, frame_rate: float) -> None:
    """Write RGB frames (n, H, W, 3) as an animation that repeats, WebP or GIF by the path's suffix."""
    from PIL import Image as Pillow

    first, *rest = (Pillow.fromarray(frame) for frame in frames)
    with write_whole(path) as temporary:
        duration = round(1000.0 / frame_rate)
        first.save(temporary, save_all=True, append_images=rest, duration=duration, loop=0, quality=_PREVIEW_QUALITY)


def _surround(images: Mapping[str, Image], tile_width: int) -> Image:
    """One picture of the views of one moment, rows centred."""
    rows = []
    for places in _PLACES:
        names = [name for name in places if name in images]
        if names:
            tiles = _side_by_side([images[name] for name in names], tile_width)
            rows.append(np.concatenate([_caption([rig.short_name(name) for name in names], tile_width), tiles]))
    width = max(row.shape[1] for row in rows)
    margins = [(width - row.shape[1]) // 2 for row in rows]
    return np.concatenate(
        [
            np.pad(row, ((0, 0), (left, width - row.shape[1] - left), (0, 0)))
            for row, left in zip(rows, margins, strict=True)
        ]
    )


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
