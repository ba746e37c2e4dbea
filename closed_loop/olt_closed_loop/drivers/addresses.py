"""Where a driver is and what it is shown, in one line: `grpc://HOST:PORT?cameras=alpamayo-r1&size=320x576`."""

from dataclasses import dataclass
from typing import get_args
from urllib.parse import parse_qsl, urlsplit

from olt_closed_loop.drivers.conversions import ImageFormat
from olt_generator.errors import InputError
from olt_toolkit.rigs.contracts import CONTRACTS
from olt_toolkit.rigs.rig import CAMERA_INDEX


@dataclass(frozen=True)
class DriverAddress:
    """Where a driver is, and what it is shown.

    Attributes:
        target: HOST:PORT, or the path of a Unix socket as `unix:PATH`.
        cameras: None for what the driver itself tells, or else those of `alpamayo-r1`.
        image_size: height and width, or None likewise.
        coding: of the images.
    """

    target: str
    cameras: tuple[str, ...] | None = None
    image_size: tuple[int, int] | None = None
    coding: ImageFormat = "jpeg"

    @classmethod
    def parse(cls, text: str) -> "DriverAddress":
        """The address in `//HOST:PORT?cameras=NAMES&size=HEIGHTxWIDTH&images=jpeg`, all options optional.

        NAMES is a camera contract such as `alpamayo-r1`, names of cameras with commas between, or `none`.

        Raises:
            InputError: it is none, or an option is not known.
        """
        where = f"policy grpc:{text}"
        try:
            parts = urlsplit(text)
            port = parts.port
        except ValueError as error:
            raise InputError(f"{where}: {error}; give grpc://HOST:PORT") from error
        if not parts.hostname or not port or parts.path.strip("/") or parts.username:
            raise InputError(f"{where}: give grpc://HOST:PORT, for example grpc://127.0.0.1:6789?cameras=alpamayo-r1")
        options = dict(parse_qsl(parts.query, keep_blank_values=True))
        unknown = set(options) - {"cameras", "size", "images"}
        if unknown:
            raise InputError(f"{where}: no option {', '.join(sorted(unknown))}; there are cameras, size and images")
        coding = options.get("images", "jpeg")
        if coding not in get_args(ImageFormat):
            raise InputError(f"{where}: images are coded as jpeg or png, not {coding!r}")
        cameras = read_cameras(options["cameras"], where) if "cameras" in options else None
        size = read_size(options["size"], where) if "size" in options else None
        return cls(f"{parts.netloc}", cameras, size, "png" if coding == "png" else "jpeg")


def read_cameras(text: str, where: str) -> tuple[str, ...]:
    """The cameras in the order of their indices that a text names: a contract, "none", or names with commas between.

    Raises:
        InputError: it names none that there is.
    """
    if text in CONTRACTS:
        return CONTRACTS[text].cameras
    names = [] if text == "none" else text.split(",")
    unknown = [name for name in names if name not in CAMERA_INDEX]
    if unknown:
        known = f"none, {', '.join(CONTRACTS)}, or of {', '.join(CAMERA_INDEX)}"
        raise InputError(f"{where}: no cameras {', '.join(map(repr, unknown))}; give {known}")
    return tuple(sorted(set(names), key=lambda name: CAMERA_INDEX[name]))


def read_size(text: str, where: str) -> tuple[int, int]:
    """Height and width of HEIGHTxWIDTH.

    Raises:
        InputError: it is something else.
    """
    height, _, width = text.partition("x")
    if not (height.isdecimal() and width.isdecimal() and 0 < int(height) <= 4320 and 0 < int(width) <= 7680):
        raise InputError(f"{where}: size {text!r}; give HEIGHTxWIDTH in pixels, for example 320x576")
    return int(height), int(width)
