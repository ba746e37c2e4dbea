"""Faults of cameras, as a tester makes them: what the policy is shown differs from what its cameras see."""

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.seeds import make_generator
from olt_toolkit.policy.contract import STEP_SECONDS

FaultKind = Literal["noise", "exposure", "dropped", "late", "frozen", "swapped"]

_MOST = {"noise": 255.0, "exposure": 8.0, "dropped": 1.0, "late": 10.0, "frozen": 1e6}


@dataclass(frozen=True)
class CameraFault:
    """One fault.

    Attributes:
        kind: "noise", a standard deviation in grey levels at mid grey; "exposure", in stops, less than 0 for too dark;
            "dropped", the share of pictures that do not come, for which the last one is shown again; "late", by how
            many seconds pictures are old; "frozen", from which second of the recording on the picture stays;
            "swapped", with another camera.
        camera: name of the camera, or None for all.
        amount: as `kind` says; 0 for a swap.
        other: the camera that is swapped with, or None.

    Raises:
        InputError: the amount is not one of such a fault, or a swap lacks one of its cameras.
    """

    kind: FaultKind
    camera: str | None = None
    amount: float = 0.0
    other: str | None = None

    def __post_init__(self) -> None:
        if self.kind == "swapped":
            if self.camera is None or self.other is None or self.camera == self.other:
                raise InputError("camera fault swapped: give two cameras, as in swapped:cross_left=cross_right")
            return
        most = _MOST[self.kind]
        least = -most if self.kind == "exposure" else 0.0
        if not least <= self.amount <= most:
            raise InputError(f"camera fault {self.kind}: amount {self.amount}; give {least:g} to {most:g}")
        if self.kind == "late" and abs(self.amount / STEP_SECONDS - round(self.amount / STEP_SECONDS)) > 1e-6:
            raise InputError(f"camera fault late: {self.amount} s; give a multiple of {STEP_SECONDS} s")

    @property
    def words(self) -> str:
        """As `parse_camera_fault` reads it."""
        amount = self.other if self.kind == "swapped" else f"{self.amount:g}"
        return f"{self.kind}{f':{self.camera}' if self.camera else ''}={amount}"

    def touches(self, camera: str) -> bool:
        """Whether the pictures of a camera are concerned."""
        return self.camera in (None, camera) or self.other == camera


def parse_camera_fault(text: str, cameras: Sequence[str]) -> CameraFault:
    """KIND=AMOUNT for all cameras, KIND:CAMERA=AMOUNT for one, or swapped:CAMERA=CAMERA.

    A camera is told by its name or a part of it that no other of `cameras` has.

    Raises:
        InputError: the text says something else.
    """
    head, equals, amount = text.partition("=")
    word, colon, camera = head.partition(":")
    kind: FaultKind | None = next((known for known in get_args(FaultKind) if known == word), None)
    if kind is None or not equals:
        raise InputError(
            f"camera fault {text!r}: give KIND=AMOUNT or KIND:CAMERA=AMOUNT, "
            f"KIND one of {', '.join(get_args(FaultKind))}"
        )
    name = _find_camera(camera, cameras, text) if colon else None
    if kind == "swapped":
        return CameraFault("swapped", name, other=_find_camera(amount, cameras, text))
    try:
        return CameraFault(kind, name, float(amount))
    except ValueError as error:
        raise InputError(f"camera fault {text!r}: {amount!r} is no number") from error


def _find_camera(part: str, cameras: Sequence[str], text: str) -> str:
    found = [camera for camera in cameras if part and part in camera]
    if part in cameras:
        return part
    if len(found) != 1:
        raise InputError(f"camera fault {text!r}: {part!r} is no one of the cameras {', '.join(cameras)}")
    return found[0]


class FaultyCameras:
    """Shows pictures of the cameras of one rollout with their faults, in the order in which they are given.

    `affected` counts by fault the pictures of all cameras that it changed.

    Raises:
        InputError: a fault is of a camera that is not there, where there are any.
    """

    def __init__(self, faults: Sequence[CameraFault], cameras: Sequence[str], seed: int) -> None:
        for fault in faults if cameras else ():
            missing = [name for name in (fault.camera, fault.other) if name and name not in cameras]
            if missing:
                raise InputError(f"camera fault {fault.words}: the policy has {', '.join(cameras)}, not {missing[0]}")
        self._faults, self._cameras, self._seed = tuple(faults), tuple(cameras), seed
        self._shown: dict[int, list[NDArray[np.uint8]]] = {}
        self._queues = {
            index: deque[NDArray[np.uint8]](maxlen=round(fault.amount / STEP_SECONDS) + 1)
            for index, fault in enumerate(faults)
            if fault.kind == "late"
        }
        self.affected: Counter[str] = Counter()

    def show(self, images: NDArray[np.uint8], time_us: int) -> NDArray[np.uint8]:
        """The pictures (cameras, 3, H, W) of one time, of which each is the next one, as the policy gets them."""
        for index, fault in enumerate(self._faults):
            before, images = images, self._apply(index, fault, images, time_us)
            self.affected[fault.words] += int(np.any(before != images, axis=(1, 2, 3)).sum())
        return images

    def _apply(self, index: int, fault: CameraFault, images: NDArray[np.uint8], time_us: int) -> NDArray[np.uint8]:
        touched = [row for row, camera in enumerate(self._cameras) if fault.touches(camera)]
        seen, changed = images[touched], images.copy()
        generator = make_generator("camera fault", index, self._seed, time_us)
        if fault.kind == "noise":
            changed[touched] = _add_noise(seen, fault.amount, generator)
        elif fault.kind == "exposure":
            # Grey levels grow about as the square root of light.
            changed[touched] = np.clip(seen * np.float32(2.0 ** (fault.amount / 2.0)) + 0.5, 0.0, 255.0)
        elif fault.kind == "late":
            self._queues[index].append(seen)
            changed[touched] = self._queues[index][0]
        elif fault.kind == "swapped":
            changed[touched] = seen[::-1]
        else:
            last = self._shown.get(index, list(seen))
            if fault.kind == "dropped":
                kept = generator.random(len(touched)) < fault.amount
            else:
                kept = np.full(len(touched), time_us * 1e-6 > fault.amount)
            shown = [old if keep else new for old, new, keep in zip(last, seen, kept, strict=True)]
            self._shown[index] = shown
            changed[touched] = shown
        return changed


def _add_noise(seen: NDArray[np.uint8], noise: float, generator: np.random.Generator) -> NDArray[np.floating[Any]]:
    """Grey levels with noise that grows as the root of the light; a part of it is always there."""
    level = seen.astype(np.float32)
    sigma = np.float32(noise) * np.sqrt(np.float32(0.35) + level * np.float32(0.65 / 128.0))
    level += sigma * generator.standard_normal(level.shape, dtype=np.float32)
    return np.clip(level + np.float32(0.5), 0.0, 255.0)
