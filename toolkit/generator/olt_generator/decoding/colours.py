"""Colours of decoded frames as 8-bit RGB of a standard screen (BT.709 primaries, BT.1886 gamma 2.4).

High dynamic range is brought down by display light. HLG becomes the light of its reference screen of 1000 cd/m2
(ITU-R BT.2100, table 5: inverse OETF, then gamma 1.2, here of R, G and B each and not of their luminance: strong
colours come out a few grey levels more saturated, as in players that do so). PQ becomes its absolute light (table 4).
Reference white, 203 cd/m2 (ITU-R BT.2408, table 1: 75 % HLG, 58 % PQ), becomes white of the standard screen. Below
90 % of it light is kept as it is, which is the inverse of the direct mapping of BT.2408, section 5.1; above, a shoulder
of tanh with the same slope takes all that is brighter into the last tenth, as the knee of BT.2390, section 5.4 does.
"""

from functools import cache

import cv2
import numpy as np
from av.video.frame import VideoFrame
from av.video.reformatter import ColorPrimaries, Colorspace, ColorTrc, VideoReformatter
from numpy.typing import NDArray

from olt_generator.errors import InputError

Float = NDArray[np.float32]

REFERENCE_WHITE = 203.0
"""Light in cd/m2 of what is white on a standard screen."""
_HLG_PEAK, _HLG_GAMMA = 1000.0, 1.2
_KNEE = 0.9
_SCREEN_GAMMA = 2.4
# Linear RGB of other primaries to those of BT.709 (ITU-R BT.2087, and the same computation for SMPTE EG 432-1, D65).
_TO_BT709: dict[int, Float] = {
    ColorPrimaries.BT2020: np.array(
        [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]], np.float32
    ),
    ColorPrimaries.SMPTE432: np.array(
        [[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]], np.float32
    ),
}
# Matrices from YCbCr to RGB by their number in ITU-T H.273: RGB, BT.709, FCC, two of BT.601, SMPTE 240M, BT.2020.
_KNOWN_MATRICES = frozenset({0, 1, 4, 5, 6, 7, 9})
_UNTOLD = frozenset({2, 3})
# Larger pictures that do not tell their matrix are taken to be BT.709, smaller ones BT.601, as players do.
_SD_WIDTH, _SD_HEIGHT = 1024, 576
_NOT_FOR_SCREENS = {ColorTrc.LINEAR: "linear", ColorTrc.LOG: "logarithmic", ColorTrc.LOG_SQRT: "logarithmic"}


class ColourReader:
    """Turns frames into RGB, and says which of several readings it took."""

    def __init__(self) -> None:
        self._reformatter = VideoReformatter()

    def read(self, frame: VideoFrame, size: tuple[int, int], where: str) -> tuple[NDArray[np.uint8], str | None]:
        """The picture (H, W, 3) uint8 RGB, and what was assumed of its colours, if anything.

        Pictures whose colours take much work are first scaled down to `size` (width, height) where this is smaller.

        Raises:
            InputError: the colours are coded in a way that is not known, which would give others.
        """
        matrix, assumed = _matrix(frame, where)
        transfer, to_bt709 = _transfer(frame, where), _TO_BT709.get(frame.color_primaries)
        is_hdr = transfer in (ColorTrc.SMPTE2084, ColorTrc.ARIB_STD_B67)
        if not is_hdr and to_bt709 is None:
            return self._reformat(frame, "rgb24", matrix), assumed
        codes = self._reformat(frame, "rgb48le", matrix)
        if size[0] < codes.shape[1] and size[1] < codes.shape[0]:
            codes = cv2.resize(codes, size, interpolation=cv2.INTER_AREA)
        light = _light_table(transfer)[np.asarray(codes, np.uint16)]
        if to_bt709 is not None:
            light = light.reshape(-1, 3) @ to_bt709.T
            light = light.reshape(codes.shape)
        return _to_screen(light), _word_tone_mapping(transfer) if is_hdr else assumed

    def _reformat(self, frame: VideoFrame, layout: str, matrix: Colorspace | None) -> NDArray:
        return self._reformatter.reformat(frame, format=layout, src_colorspace=matrix).to_ndarray()


def _matrix(frame: VideoFrame, where: str) -> tuple[Colorspace | None, str | None]:
    """The matrix to take in place of the frame's own, and what that assumes."""
    number = int(frame.colorspace)
    if frame.format.is_rgb or number in _KNOWN_MATRICES or "gray" in frame.format.name:
        return None, None
    if number not in _UNTOLD:
        raise InputError(f"{where}: colours are coded by matrix {number} of H.273, not known here; convert to BT.709")
    if frame.color_primaries == ColorPrimaries.BT2020:
        return Colorspace.BT2020, "The file does not tell its colour matrix; BT.2020 is taken, as its primaries are."
    if frame.width > _SD_WIDTH or frame.height > _SD_HEIGHT:
        return Colorspace.ITU709, "The file does not tell its colour matrix; BT.709 is taken, as for all HD video."
    return Colorspace.ITU601, "The file does not tell its colour matrix; BT.601 is taken, as for all SD video."


def _transfer(frame: VideoFrame, where: str) -> int:
    transfer = frame.color_trc
    if transfer in _NOT_FOR_SCREENS:
        raise InputError(
            f"{where}: brightness is coded {_NOT_FOR_SCREENS[ColorTrc(transfer)]}, for grading and not for screens; "
            "convert the video to BT.709"
        )
    is_dolby = any(frame.side_data.get(kind) is not None for kind in ("DOVI_RPU_BUFFER", "DOVI_METADATA"))
    if is_dolby and transfer in (ColorTrc.UNSPECIFIED, 0):
        raise InputError(
            f"{where}: is Dolby Vision without a layer that other screens can show; convert the video to BT.709"
        )
    return int(transfer)


@cache
def _light_table(transfer: int) -> Float:
    """Light (65536,) by 16-bit code, relative to reference white."""
    code = np.linspace(0.0, 1.0, 65536)
    if transfer == ColorTrc.SMPTE2084:
        m1, m2, c1, c2, c3 = 2610 / 16384, 2523 / 32, 3424 / 4096, 2413 / 128, 2392 / 128
        root = code ** (1.0 / m2)
        light = 10_000.0 / REFERENCE_WHITE * (np.maximum(root - c1, 0.0) / (c2 - c3 * root)) ** (1.0 / m1)
    elif transfer == ColorTrc.ARIB_STD_B67:
        a = 0.17883277
        b, c = 1.0 - 4.0 * a, 0.5 - a * np.log(4.0 * a)
        scene = np.where(code <= 0.5, code**2 / 3.0, (np.exp((code - c) / a) + b) / 12.0)
        light = _HLG_PEAK / REFERENCE_WHITE * scene**_HLG_GAMMA
    else:
        light = code**_SCREEN_GAMMA
    return light.astype(np.float32)


def _to_screen(light: Float) -> NDArray[np.uint8]:
    """Linear BT.709 RGB relative to reference white as the codes of a standard screen."""
    shoulder = _KNEE + (1.0 - _KNEE) * np.tanh((light - _KNEE) / (1.0 - _KNEE))
    shown = np.where(light > _KNEE, shoulder, np.maximum(light, 0.0))
    return np.rint(255.0 * shown ** np.float32(1.0 / _SCREEN_GAMMA)).astype(np.uint8)


def _word_tone_mapping(transfer: int) -> str:
    name = "PQ" if transfer == ColorTrc.SMPTE2084 else "HLG"
    return (
        f"The video is {name} (high dynamic range); it is tone-mapped to BT.709 with reference white of "
        f"{REFERENCE_WHITE:.0f} cd/m2 as white, and what is brighter pressed together."
    )
