"""Sequences of the KITTI odometry benchmark: left gray camera, calibration and camera poses.

Layout: `image_0/*.png` (or jpg), `calib.txt`, `poses.txt` and, where it is there, `times.txt`. In the benchmark's own
tree the poses of `sequences/06` lie in `poses/06.txt`.

`calib.txt` holds projection matrices, one a line, the first that of the left gray camera, with or without its name
`P0:` before it. `poses.txt` holds the first three rows of T_start_camera, one frame a line; `times.txt` seconds.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from olt_datasets.sources.content import hash_content, read_content
from olt_datasets.sources.kitti import PASSAT, check_increasing, kitti_reader, list_images, read_images, read_text
from olt_generator import InputError, PinholeCamera, Trajectory
from olt_generator.motion.mounting import align_mounting
from olt_generator.poses import Array, camera_pose_in_rig, invert, make_pose
from olt_toolkit.recordings.recording import Recording

# KITTI's sensor sketch: camera 0 stands 1.65 m above the road; calib_imu_to_velo and calib_velo_to_cam of the raw data
# place it 1.08 m ahead and 0.32 m to the left of the IMU, which sits close to the rear axle.
CAMERA_POSITION = (1.08, 0.32, 1.65)
FRAME_RATE = 9.65
NAME = "kitti_odometry"
# Raw drives that the sequences of the odometry benchmark were cut from (its development kit).
RAW_DRIVES = {
    "00": "2011_10_03_drive_0027",
    "01": "2011_10_03_drive_0042",
    "02": "2011_10_03_drive_0034",
    "03": "2011_09_26_drive_0067",
    "04": "2011_09_30_drive_0016",
    "05": "2011_09_30_drive_0018",
    "06": "2011_09_30_drive_0020",
    "07": "2011_09_30_drive_0027",
    "08": "2011_09_30_drive_0028",
    "09": "2011_09_30_drive_0033",
    "10": "2011_09_30_drive_0034",
}


# Of the products of rows, of which four digits are sure.
_ROTATION_ERROR = 1e-3


class KittiOdometrySequence:
    """A sequence folder; see `KittiDrive`."""

    camera = "image_0"

    def __init__(self, path: Path) -> None:
        """Read all but the images; InputError where files are missing, damaged or too many for times or poses."""
        self._name = path.name
        self.images = list_images(path / "image_0")
        if not self.images:
            raise InputError(f"{path / 'image_0'}: holds no images; copy the sequence again")
        self.image_us, assumed = _read_times(path, len(self.images))
        self._projection = _read_rows(path / "calib.txt", 12)[0].reshape(3, 4)
        apart = path.parent.parent / "poses" / f"{path.name}.txt"
        poses = apart if apart.is_file() else path / "poses.txt"
        self._T_start_camera = None
        if poses.is_file():
            rows = _read_rows(poses, 12).reshape(-1, 3, 4)
            if len(rows) != len(self.images):
                raise InputError(f"{poses}: {len(rows)} poses for {len(self.images)} images; copy the sequence again")
            _check_rotations(rows[..., :3], poses)
            self._T_start_camera = make_pose(rows[..., :3], rows[..., 3])
        self.has_motion = self._T_start_camera is not None
        level = camera_pose_in_rig(CAMERA_POSITION, 0.0, 0.0, 0.0)
        aligned = None if self._T_start_camera is None else align_mounting(self._T_start_camera, level)
        self._T_rig_camera = level if aligned is None else aligned
        self._assumptions = (
            "The camera is mounted as in KITTI's sensor sketch, 1.65 m above the road, and "
            + (
                "where it looks is not known, because there is no true motion to tell it: its axis is taken for rig x."
                if aligned is None
                else "the rig's x axis is the usual direction in which the true poses move the rear axle."
            ),
            "The vehicle has the published size of KITTI's VW Passat.",
            *assumed,
        )
        raw = RAW_DRIVES.get(path.name)
        part_of = () if raw is None else (f"It is a part of KITTI's raw drive {raw}; do not split them apart.",)
        self.notes = (*self._assumptions, *part_of)

    def identify(self) -> str:
        """See `KittiDrive.identify`: a hash of the first, the middle and the last image's file and of their number.

        Times and poses do not enter it, because copies of a sequence come with and without them.
        """
        count = len(self.images)
        images = (read_content(self.images[index]) for index in (0, count // 2, count - 1))
        return hash_content(str(count).encode(), *images)

    def record(self, indices: NDArray[np.intp], width: int) -> Recording:
        """See `KittiDrive.record`."""
        frames, size = read_images([self.images[index] for index in indices], width)
        (fx, _, cx, _), (_, fy, cy, _) = self._projection[0], self._projection[1]
        camera = PinholeCamera(size[0], size[1], fx, fy, cx, cy).resized(frames.shape[2], frames.shape[1])
        T_rig_camera, reference = self._T_rig_camera, None
        if self._T_start_camera is not None:
            # From the start's rig, whose z is up, rather than from its camera.
            reference = Trajectory(self.image_us, T_rig_camera @ self._T_start_camera @ invert(T_rig_camera))
        return Recording(
            name=self._name,
            source=NAME,
            frames=frames,
            timestamps_us=self.image_us[indices],
            camera=camera,
            T_rig_camera=T_rig_camera,
            vehicle=PASSAT,
            assumptions=self._assumptions,
            reference=reference,
        )


def _check_rotations(matrices: Array, path: Path) -> None:
    off = np.abs(matrices @ np.swapaxes(matrices, 1, 2) - np.eye(3)).max(axis=(1, 2))
    wrong = (off > _ROTATION_ERROR) | (np.linalg.det(matrices) < 0.0)
    if wrong.any():
        raise InputError(f"{path}, line {np.argmax(wrong) + 1}: holds no rotation beside its position; copy it again")


def _read_times(path: Path, count: int) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Microseconds (n,) since the first frame, and what was assumed about them."""
    if not (path / "times.txt").is_file():
        assumed = f"The sequence has no times.txt; KITTI's mean rate of {FRAME_RATE} images per second is taken."
        return np.rint(np.arange(count) * 1e6 / FRAME_RATE).astype(np.int64), (assumed,)
    times = _read_rows(path / "times.txt", 1)[:, 0]
    if len(times) != count:
        raise InputError(f"{path / 'times.txt'}: {len(times)} times for {count} images; copy the sequence again")
    return check_increasing(np.rint((times - times[0]) * 1e6).astype(np.int64), path / "times.txt"), ()


def _read_rows(path: Path, count: int) -> Array:
    """Rows (n, count) of a text file; a name with a colon at the start of a line is left out."""
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
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


def is_sequence(path: Path) -> bool:
    """Whether a folder looks like a sequence, judged by the names in it."""
    return (path / "image_0").is_dir() and (path / "calib.txt").is_file()


DATASET = kitti_reader(NAME, is_sequence, KittiOdometrySequence)
