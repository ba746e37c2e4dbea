"""Lenses of cameras of which nothing is known: given by the user, told by the turns in the video, or assumed."""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from olt_generator import Camera, FthetaCamera, InputError, PinholeCamera, estimate_field_of_view
from olt_generator.camera_spread import Origin, Spread
from olt_generator.files import write_whole
from olt_toolkit import load_rig
from olt_toolkit.runtime.json_files import read_json

# The rig in which an unknown camera is taken to be, and its only camera.
RIG, CAMERA = "dashcam", "front"
# Wider lenses are built to keep angles rather than straight lines.
WIDEST_PINHOLE = np.radians(100.0)
FIELD_OF_VIEW_RANGE = (np.radians(10.0), np.radians(200.0))
# Phones see 55 to 75 degrees across in video and dash cameras 90 to 130, most of them by a fisheye lens: their focal
# lengths are from 1.35 down to 0.62 times that of the default of 70 degrees.
ASSUMED_SPREAD = Spread(0.3, "assumed")
# Makers round, tell the diagonal, and stabilization crops; who gives a field of view is taken to be this sure of it.
GIVEN_SPREAD = Spread(0.03, "given")
# Standard deviations from the 5th to the 95th percentile of a normal distribution.
_SIGMAS_IN_INTERVAL = 2.0 * 1.645
_MOST_BYTES = 1 << 16


@dataclass(frozen=True)
class AssumedLens:
    """A horizontal field of view in radians, the sentence that says where it comes from, and how sure it is."""

    field_of_view: float
    sentence: str
    spread: Spread = ASSUMED_SPREAD

    @classmethod
    def read(cls, path: Path) -> "AssumedLens":
        """The lens that `write` kept; an `InputError` where the file holds none."""
        kept = read_json(path, "lens of a video", _MOST_BYTES)
        match kept:
            case {
                "field_of_view": float(angle),
                "sentence": str(sentence),
                "spread": {"relative": float(relative)} as spread,
            }:
                origin = next((each for each in get_args(Origin) if each == spread.get("origin")), None)
                in_range = FIELD_OF_VIEW_RANGE[0] <= angle <= FIELD_OF_VIEW_RANGE[1] and 0.0 <= relative < math.inf
                if in_range and origin is not None:
                    return cls(angle, sentence, Spread(relative, origin))
        raise InputError(f"{path}: holds no lens of a video; remove the file, and the lens is looked for again")

    def write(self, path: Path) -> None:
        """Keep the lens in a file, which appears whole."""
        with write_whole(path) as temporary:
            temporary.write_text(json.dumps(asdict(self)))


def find_field_of_view(frames: NDArray[np.uint8], timestamps_us: NDArray[np.int64]) -> AssumedLens:
    """The field of view as estimated from frames (n, H, W, 3) and their times (n,), else as assumed for dashcams.

    Raises:
        InputError: the pictures are portraits and do not tell it, because the default is that of landscapes.
    """
    estimate = estimate_field_of_view(frames, timestamps_us, assume_camera)
    if estimate.field_of_view is not None and estimate.interval is not None:
        low, high = np.degrees(estimate.interval)
        spread = math.log(_focal_length(estimate.interval[0]) / _focal_length(estimate.interval[1]))
        return describe_lens(
            estimate.field_of_view,
            f"estimated from the turns in the video, likely between {low:.0f} and {high:.0f}",
            Spread(spread / _SIGMAS_IN_INTERVAL, "estimated"),
        )
    height, width = frames.shape[1:3]
    if height > width:
        raise InputError(
            f"the pictures are portraits ({width} x {height} pixels): no default fits them, since a phone upright sees "
            f"about 40 degrees across and a part cut out of a landscape as little as 25, and {estimate.reason}; give "
            "the field of view across the shorter side with --fov, or --rotate if the video lies on its side"
        )
    dashcam = load_rig(RIG)[CAMERA].camera
    edges = dashcam.rays(np.array([[-0.5, dashcam.cy], [dashcam.width - 0.5, dashcam.cy]]))
    usual = float(np.arccos(edges[0] @ edges[1]))
    return describe_lens(usual, f"the default for dashcams; the video does not tell: {estimate.reason}")


def assume_camera(width: int, height: int, field_of_view: float) -> Camera:
    """A centred camera, pinhole or f-theta, that sees so many radians across; InputError beyond 10 to 200 degrees."""
    low, high = FIELD_OF_VIEW_RANGE
    if not low <= field_of_view <= high:
        raise InputError(
            f"field of view {np.degrees(field_of_view):.1f} degrees: give one between {np.degrees(low):.0f} and "
            f"{np.degrees(high):.0f} degrees"
        )
    if field_of_view <= WIDEST_PINHOLE:
        return PinholeCamera.from_field_of_view(width, height, field_of_view)
    return FthetaCamera.equidistant(width, height, 0.5 * (width - 1), 0.5 * (height - 1), width / field_of_view)


def describe_lens(field_of_view: float, origin: str, spread: Spread = ASSUMED_SPREAD) -> AssumedLens:
    """The lens that is assumed for a horizontal field of view in radians, which comes from `origin`."""
    lens = "without distortion" if field_of_view <= WIDEST_PINHOLE else "with an equidistant fisheye lens"
    return AssumedLens(
        field_of_view,
        f"The camera has a horizontal field of view of {np.degrees(field_of_view):.0f} degrees ({origin}), {lens}, and "
        "its axis is in the middle of the image.",
        spread,
    )


def height_spread(origin: Origin) -> Spread:
    """How well the height of a camera is known that the user measured with a tape, or that nobody knows.

    The default of 1.5 m is between cars, whose windshield cameras are 1.2 to 1.4 m high, and vans at 1.8 m.
    """
    return Spread(0.02, origin) if origin == "given" else Spread(0.15, "assumed")


def _focal_length(field_of_view: float) -> float:
    """Focal length in image widths of the lens that `assume_camera` takes."""
    return 0.5 / math.tan(0.5 * field_of_view) if field_of_view <= WIDEST_PINHOLE else 1.0 / field_of_view
