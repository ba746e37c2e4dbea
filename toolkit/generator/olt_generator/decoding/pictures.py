"""From a decoded frame to the picture that a player shows: colours, fields, pixel aspect, and which way up."""

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from numpy.typing import NDArray

from olt_generator.decoding.colours import ColourReader
from olt_generator.decoding.fields import FieldReader, fill_lines, is_combed
from olt_generator.decoding.orientation import AS_STORED, Orientation, read_orientation
from olt_generator.errors import InputError


class PictureReader:
    """Makes pictures of the frames of one stream, all of one size; `notes` says which of several readings was taken."""

    def __init__(self, path: Path, stream: VideoStream, width: int, turned: Orientation = AS_STORED) -> None:
        self._path, self._width, self._turned = path, width, turned
        self._aspect = _pixel_aspect(stream)
        self._colours, self._fields = ColourReader(), None
        self._shape: tuple[int, ...] | None = None
        self.notes: list[str] = []
        if self._aspect != 1:
            self._note(
                f"Pixels are {self._aspect.numerator} wide to {self._aspect.denominator} high; pictures are stretched "
                "to the size at which they are shown."
            )

    def read(self, frame: VideoFrame, number: int) -> NDArray[np.uint8]:
        """The picture (H, W, 3), RGB, at most `width` wide, of the frame of this number.

        Raises:
            InputError: see `read_orientation` and `ColourReader.read`; the size changes.
        """
        where = f"{self._path}: frame {number}"
        orientation = read_orientation(frame, where)
        size = self._stored_size(frame, orientation.transposed != self._turned.transposed)
        image = self._rgb(frame, size, where)
        image = self._turned.apply(orientation.apply(_scale(image, size)))
        if self._shape not in (None, image.shape):
            raise InputError(
                f"{where}: is {image.shape[1]} x {image.shape[0]} pixels, those before are {self._shape[1]} x "
                f"{self._shape[0]}; cut the video there"
            )
        self._shape = image.shape
        if orientation != AS_STORED:
            self._note("The file says that its pictures are turned or mirrored; they are, as players show them.")
        return image

    def _stored_size(self, frame: VideoFrame, transposed: bool) -> tuple[int, int]:
        """Width and height of the picture before it is turned."""
        width, height = max(1, round(frame.width * self._aspect)), frame.height
        shrink = min(1.0, self._width / (height if transposed else width))
        return max(1, round(width * shrink)), max(1, round(height * shrink))

    def _rgb(self, frame: VideoFrame, size: tuple[int, int], where: str) -> NDArray[np.uint8]:
        flagged = frame.interlaced_frame
        if not flagged and not _shows_comb(frame):
            return self._coloured(frame, size, where)
        layout = frame.width, frame.height, frame.format.name
        if self._fields is None or self._fields.layout != layout:
            self._fields = FieldReader(frame)
        says = "The file says that it is interlaced" if flagged else "Pictures show the comb of interlaced video"
        self._note(f"{says}; the upper field of each frame is taken.")
        field = self._coloured(self._fields.read(frame), size, where)
        # High dynamic range may have been scaled down to the final size already.
        return field if field.shape[1] != frame.width else fill_lines(field, frame.height)

    def _coloured(self, frame: VideoFrame, size: tuple[int, int], where: str) -> NDArray[np.uint8]:
        image, assumed = self._colours.read(frame, size, where)
        if assumed is not None:
            self._note(assumed)
        return image

    def _note(self, sentence: str) -> None:
        if sentence not in self.notes:
            self.notes.append(sentence)


def _pixel_aspect(stream: VideoStream) -> Fraction:
    """Width of a pixel by its height, as the container tells it or else the codec; 1 where neither does."""
    for aspect in (stream.sample_aspect_ratio, stream.codec_context.sample_aspect_ratio):
        if aspect is not None and aspect > 0:
            return Fraction(aspect)
    return Fraction(1)


def _shows_comb(frame: VideoFrame) -> bool:
    """Whether the brightness of a frame is combed; of formats that keep it in a plane of its own."""
    bits = frame.format.components[0].bits
    if frame.format.is_rgb or not frame.format.is_planar or frame.format.is_big_endian:
        return False
    plane = frame.planes[0]
    # Planes have the buffer protocol, which PyAV's stubs do not tell.
    content = np.frombuffer(plane, np.uint8)  # pyright: ignore[reportArgumentType, reportCallIssue]
    lines = content.reshape(plane.height, plane.line_size)
    luma = lines[:, : plane.width] if bits == 8 else lines.view(np.uint16)[:, : plane.width] >> (bits - 8)
    return is_combed(luma.astype(np.uint8, copy=False))


def _scale(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """The image at a width and height: stretched where it grows, then averaged over areas where it shrinks."""
    width, height = max(size[0], image.shape[1]), max(size[1], image.shape[0])
    if (width, height) != image.shape[1::-1]:
        image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)
    if (width, height) != size:
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    return image
