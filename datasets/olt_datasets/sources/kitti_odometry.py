"""Sequences of the KITTI odometry benchmark: left gray camera, calibration and camera poses.

Layout: `image_0/*.png` (or jpg), `calib.txt`, `poses.txt` and, where it is there, `times.txt`. In the benchmark's own
tree the poses of `sequences/06` lie in `poses/06.txt`, which the data set's reader finds and this one does not.

`calib.txt` holds projection matrices, one a line, the first that of the left gray camera, with or without its name
`P0:` before it. `poses.txt` holds the first three rows of T_start_camera, one frame a line; `times.txt` seconds.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from olt_datasets.sources.kitti import PASSAT, check_increasing, decode_image, list_images, trim_reference, usual_travel
from olt_generator.cameras import PinholeCamera
from olt_generator.errors import InputError
from olt_generator.poses import Array, aim_camera, camera_pose_in_rig, invert, make_pose
from olt_generator.trajectory import Trajectory
from olt_generator.video import shrink
from olt_toolkit.recordings.recording import OpenOptions, Recording

# KITTI's sensor sketch: camera 0 stands 1.65 m above the road; calib_imu_to_velo and calib_velo_to_cam of the raw data
# place it 1.08 m ahead and 0.32 m to the left of the IMU, which sits close to the rear axle.
CAMERA_POSITION = (1.08, 0.32, 1.65)
FRAME_RATE = 9.65
NAME = "kitti_odometry"


class KittiOdometrySequence:
    """A sequence folder, of which times, calibration and poses are read; images as they are needed.

    Attributes:
        path: the folder.
        image_us: (n,) int64 times of the images, the first is 0.
        has_poses: whether the motion of the camera is known.
    """

    def __init__(self, path: Path, poses: Path | None = None) -> None:
        """Read all but the images.

        Args:
            path: the sequence.
            poses: the file with its poses, where it is not its own `poses.txt`.

        Raises:
            InputError: files are missing, damaged or not as many as their times or poses.
        """
        self._images = list_images(path / "image_0")
        if not self._images:
            raise InputError(f"{path / 'image_0'}: holds no images; copy the sequence again")
        self.path = path
        self.image_us, self._assumed = _read_times(path, len(self._images))
        self._projection = _read_rows(path / "calib.txt", 12)[0].reshape(3, 4)
        self._T_start_camera = _read_poses(poses or path / "poses.txt", len(self._images))
        self.has_poses = self._T_start_camera is not None

    def record(self, indices: NDArray[np.intp], width: int) -> Recording:
        """Decode some images, shrunk to `width`; times are those of the sequence, and so is the whole reference.

        Raises:
            InputError: an image is damaged.
        """
        frames, size = _read_images([self._images[index] for index in indices], width)
        (fx, _, cx, _), (_, fy, cy, _) = self._projection[0], self._projection[1]
        camera = PinholeCamera(size[0], size[1], fx, fy, cx, cy).resized(frames.shape[2], frames.shape[1])
        T_rig_camera = _mount(self._T_start_camera)
        reference = None
        if self._T_start_camera is not None:
            # From the start's rig, whose z is up, rather than from its camera.
            T_start_rig = T_rig_camera @ self._T_start_camera @ invert(T_rig_camera)
            reference = Trajectory(self.image_us, T_start_rig)
        return Recording(
            name=self.path.name,
            source=NAME,
            frames=frames,
            timestamps_us=self.image_us[indices],
            camera=camera,
            T_rig_camera=T_rig_camera,
            vehicle=PASSAT,
            assumptions=self.assumptions,
            reference=reference,
        )

    @property
    def assumptions(self) -> tuple[str, ...]:
        """A sentence for everything that is assumed."""
        return (
            "The camera is mounted as in KITTI's sensor sketch, 1.65 m above the road, and the rig's x axis is "
            + ("the usual direction of travel of the true poses." if self.has_poses else "the camera's axis."),
            "The vehicle has the published size of KITTI's VW Passat.",
            *self._assumed,
        )


class KittiOdometrySource:
    """Opens a sequence folder of the KITTI odometry benchmark."""

    name = NAME

    def recognises(self, path: Path) -> bool:
        """See `Source.recognises`; judged by the folder and file names."""
        return (path / "image_0").is_dir() and (path / "calib.txt").is_file()

    def open(self, path: Path, options: OpenOptions) -> Recording:
        """See `Source.open`; field of view and height are those of KITTI's car, whatever the options say."""
        sequence = KittiOdometrySequence(path)
        recording = sequence.record(np.flatnonzero(sequence.image_us < options.duration * 1e6), options.width)
        return trim_reference(recording)


def _read_images(files: list[Path], width: int) -> tuple[NDArray[np.uint8], tuple[int, int]]:
    """Images (n, H, W, 3) RGB, shrunk to `width`, and their width and height as they are stored."""
    images, sizes = [], set()
    for file in files:
        image = decode_image(file)
        sizes.add((image.shape[1], image.shape[0]))
        if len(sizes) > 1:
            raise InputError(f"{file}: is {image.shape[1]} x {image.shape[0]} pixels, unlike the images before it")
        images.append(shrink(image, width))
    return np.stack(images), sizes.pop()


def _read_times(path: Path, count: int) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Microseconds (n,) since the first frame, and what was assumed about them."""
    if not (path / "times.txt").is_file():
        assumed = f"The sequence has no times.txt; KITTI's mean rate of {FRAME_RATE} images per second is taken."
        return np.rint(np.arange(count) * 1e6 / FRAME_RATE).astype(np.int64), (assumed,)
    times = _read_rows(path / "times.txt", 1)[:, 0]
    if len(times) != count:
        raise InputError(f"{path / 'times.txt'}: {len(times)} times for {count} images; copy the sequence again")
    return check_increasing(np.rint((times - times[0]) * 1e6).astype(np.int64), path / "times.txt"), ()


def _read_poses(path: Path, count: int) -> Array | None:
    """T_start_camera (n, 4, 4), None where the file is absent."""
    if not path.is_file():
        return None
    rows = _read_rows(path, 12).reshape(-1, 3, 4)
    if len(rows) != count:
        raise InputError(f"{path}: {len(rows)} poses for {count} images; copy the sequence again")
    return make_pose(rows[..., :3], rows[..., 3])


def _mount(T_start_camera: Array | None) -> Array:
    """Mounting whose pitch and yaw are those for which the vehicle travels along rig x."""
    travel = None if T_start_camera is None else usual_travel(T_start_camera)
    if travel is None:
        return camera_pose_in_rig(CAMERA_POSITION, 0.0, 0.0, 0.0)
    return aim_camera(CAMERA_POSITION, 0.0, travel)


def _read_rows(path: Path, count: int) -> Array:
    """Rows (n, count) of a text file; a name with a colon at the start of a line is left out."""
    rows = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), start=1):
        words = [word for word in line.split() if not word.endswith(":")]
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            raise InputError(f"{path}, line {number}: holds something that is no number; copy it again") from error
        if len(values) != count:
            raise InputError(f"{path}, line {number}: {len(values)} numbers instead of {count}; copy it again")
        if not np.all(np.isfinite(values)):
            raise InputError(f"{path}, line {number}: holds a number that is not finite; copy it again")
        rows.append(values)
    if not rows:
        raise InputError(f"{path}: is empty; copy it again")
    return np.array(rows)


SOURCE = KittiOdometrySource()
