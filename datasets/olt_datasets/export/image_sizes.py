"""Sizes of the images of clips, camera by camera: a LeRobot data set has one for each camera."""

from collections import Counter
from collections.abc import Mapping

from olt_datasets.export.contents import Contents
from olt_generator.errors import InputError
from olt_toolkit.clips.pai_layout import CAMERA_INTRINSICS
from olt_toolkit.clips.store import ClipStore

Size = tuple[int, int]
"""Height and width in pixels."""
Sizes = Mapping[str, Size]
"""By camera."""
Counts = dict[str, Counter[Size]]
"""How many clips have images of each size, by camera."""


def read_image_sizes(contents: Contents) -> Counts:
    """The sizes of the images of all clips; those that cannot be read are told when they are exported."""
    stores = {item.store: ClipStore(item.store) for item in contents.items}
    counts: Counts = {camera: Counter() for camera in contents.contract.cameras}
    for item in contents.items:
        try:
            rows = stores[item.store].read_rows(item.clip_id, CAMERA_INTRINSICS)
        except InputError:
            continue
        sizes = rows.droplevel(0)[["height", "width"]].astype(int)
        for camera in counts:
            counts[camera][int(sizes.at[camera, "height"]), int(sizes.at[camera, "width"])] += 1
    return counts


def only_sizes(counts: Counts) -> Sizes:
    """The one size of each camera; an `InputError` where clips differ, or none could be read."""
    for camera, sizes in counts.items():
        if len(sizes) != 1:
            found = ", ".join(f"{word_size(size)} in {clips} clips" for size, clips in sizes.most_common())
            raise InputError(
                f"{camera}: images of {found or 'no clip can be read'}, and a LeRobot data set has one size a camera; "
                "give --image-size WIDTHxHEIGHT, or export the clips apart"
            )
    return {camera: next(iter(sizes)) for camera, sizes in counts.items()}


def tell_resized(counts: Counts, sizes: Sizes) -> dict[str, dict[str, int]]:
    """By camera, how many clips have images of which other size; cameras without any are left out."""
    others = {
        camera: {word_size(size): clips for size, clips in counts[camera].items() if size != wanted}
        for camera, wanted in sizes.items()
    }
    return {camera: found for camera, found in others.items() if found}


def parse_size(text: str) -> Size:
    """Read WIDTHxHEIGHT; an `InputError` unless both are even numbers of 2 pixels or more, as video is coded."""
    width, _, height = text.partition("x")
    if (
        not (width.isdecimal() and height.isdecimal())
        or int(width) % 2
        or int(height) % 2
        or not int(width) * int(height)
    ):
        raise InputError(f"--image-size {text}: write WIDTHxHEIGHT in pixels, both even, such as 576x320")
    return int(height), int(width)


def word_size(size: Size) -> str:
    """WIDTHxHEIGHT, as people write it."""
    return f"{size[1]}x{size[0]}"
