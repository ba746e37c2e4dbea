"""Drives of the KITTI raw data: rectified left colour camera, calibration and GPS/IMU poses.

Two layouts are read: the official one, `<date>/<drive>_sync/image_02/data/*.png` with `image_02/timestamps.txt`,
`oxts/data/*.txt`, `oxts/timestamps.txt` and the calibration in `<date>/`; and a flat one, in which the calibration
lies beside `image_02/*.jpg`, `image_02_timestamps.txt`, `oxts/*.txt` and `oxts_timestamps.txt`.

The rig: its origin is the IMU's position projected to the ground, 0.93 m below (KITTI's sensor sketch; the IMU sits
close to the rear axle). Its x axis is the direction in which the vehicle travels according to the GPS/IMU, because the
IMU itself is mounted with its nose up to a degree off the road.
"""

from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation

from olt_datasets.sources.content import hash_content, read_content
from olt_datasets.sources.kitti import PASSAT, check_increasing, kitti_reader, list_images, read_images, read_text
from olt_generator import InputError, PinholeCamera, Trajectory
from olt_generator.motion.mounting import align_mounting
from olt_generator.poses import Array, invert, make_pose
from olt_toolkit.recordings.recording import Recording, StatedAccuracy

IMU_HEIGHT = 0.93
EARTH_RADIUS = 6378137.0
CAMERA_FILE, VELODYNE_FILE, IMU_FILE = "calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt"
OXTS_FIELDS = 30
NAME = "kitti_raw"
_OFFICIAL_IMAGES = "image_02/data"
ASSUMPTIONS = (
    f"The rig origin is the IMU's position projected to the ground, {IMU_HEIGHT} m below it, and is taken for the "
    "middle of the rear axle.",
    "The rig's x axis is the usual direction of travel measured by the GPS/IMU, where the vehicle moves.",
    "The vehicle has the published size of KITTI's VW Passat.",
)
_POSITIONS_ALONE = (
    "The GPS/IMU files do not tell how accurate positions and velocities are; the positions alone are the reference."
)
_STANDS = (
    "The vehicle stands throughout, so how the IMU is turned against it is not known: its axes are taken for the rig's."
)


class KittiRawDrive:
    """A drive folder; see `KittiDrive`."""

    camera, has_motion, notes = "image_02", True, ASSUMPTIONS

    def __init__(self, path: Path) -> None:
        """Read what describes the drive, no image and no GPS/IMU file; InputError names a file that is wrong."""
        if (path / _OFFICIAL_IMAGES).is_dir():
            images, image_times, calibration = path / _OFFICIAL_IMAGES, path / "image_02/timestamps.txt", path.parent
            oxts, oxts_times = path / "oxts/data", path / "oxts/timestamps.txt"
        else:
            images, image_times, calibration = path / "image_02", path / "image_02_timestamps.txt", path
            oxts, oxts_times = path / "oxts", path / "oxts_timestamps.txt"
        image_ns, oxts_ns = _read_times(image_times), _read_times(oxts_times)
        self.image_us = np.rint((image_ns - image_ns[0]) / 1000).astype(np.int64)
        self._image_ns = image_ns
        self._name = path.name
        self._oxts_us = np.rint((oxts_ns - image_ns[0]) / 1000).astype(np.int64)
        fields = {"S_rect_02": 2, "P_rect_02": 12, "R_rect_00": 9}
        self._calibration = _read_calibration(calibration / CAMERA_FILE, fields)
        self._T_imu_camera = _imu_to_camera(calibration, self._calibration)
        self._oxts = sorted(oxts.glob("*.txt"))
        self.images = list_images(images)
        for folder, what, files, times in (
            (oxts, "GPS/IMU files", self._oxts, oxts_ns),
            (images, "images", self.images, image_ns),
        ):
            if len(files) != len(times):
                raise InputError(f"{folder}: {len(files)} {what} for {len(times)} timestamps; copy the drive again")

    def identify(self) -> str:
        """See `KittiDrive.identify`: a hash of the times of all images and of the first one's file."""
        return hash_content(self._image_ns, read_content(self.images[0]))

    def record(self, indices: NDArray[np.intp], width: int) -> Recording:
        """See `KittiDrive.record`."""
        T_world_imu, accuracy = _read_oxts(self._oxts, self._oxts_us)
        T_rig_imu, moves = _align_rig(T_world_imu)
        measured = _extended(Trajectory(self._oxts_us, T_world_imu @ invert(T_rig_imu)))
        files = [self.images[index] for index in indices]
        frames, stored = read_images(files, width)
        width_02, height_02 = self._calibration["S_rect_02"].astype(int).tolist()
        if stored != (width_02, height_02):
            raise InputError(
                f"{files[0]}: is {stored[0]} x {stored[1]} pixels, S_rect_02 of the calibration says "
                f"{width_02} x {height_02}; use images and calibration of the same date"
            )
        P = self._calibration["P_rect_02"].reshape(3, 4)
        camera = PinholeCamera(width_02, height_02, float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2]))
        return Recording(
            name=self._name,
            source=NAME,
            frames=frames,
            timestamps_us=self.image_us[indices],
            camera=camera.resized(frames.shape[2], frames.shape[1]),
            T_rig_camera=T_rig_imu @ self._T_imu_camera,
            vehicle=PASSAT,
            assumptions=(
                *ASSUMPTIONS,
                *(() if moves else (_STANDS,)),
                *(() if accuracy else (_POSITIONS_ALONE,)),
            ),
            reference=Trajectory(self.image_us, measured.interpolate(self.image_us)),
            accuracy=accuracy,
        )


def _imu_to_camera(folder: Path, camera: dict[str, Array]) -> Array:
    """Pose (4, 4) of the rectified camera 2 in the IMU, from the chain of KITTI's readme: P R_rect T_velo T_imu."""
    velodyne = _read_calibration(folder / VELODYNE_FILE, {"R": 9, "T": 3})
    imu = _read_calibration(folder / IMU_FILE, {"R": 9, "T": 3})
    P = camera["P_rect_02"].reshape(3, 4)
    T_camera_rectified = make_pose(np.eye(3), np.linalg.solve(P[:, :3], P[:, 3]))
    T_rectified_first = make_pose(camera["R_rect_00"].reshape(3, 3), np.zeros(3))
    T_first_velodyne = make_pose(velodyne["R"].reshape(3, 3), velodyne["T"])
    T_velodyne_imu = make_pose(imu["R"].reshape(3, 3), imu["T"])
    return invert(T_camera_rectified @ T_rectified_first @ T_first_velodyne @ T_velodyne_imu)


def _read_calibration(path: Path, fields: dict[str, int]) -> dict[str, Array]:
    """The named fields of a `key: numbers` file; each must have the given count of finite numbers."""
    if not path.is_file():
        raise InputError(f"{path}: calibration file is missing; copy it from the KITTI download of the same date")
    lines = read_text(path).splitlines()
    texts = dict(line.split(":", 1) for line in lines if ":" in line)
    values = {}
    for field, count in fields.items():
        if field not in texts:
            raise InputError(f"{path}: field {field} is missing; copy the file again from the KITTI download")
        values[field] = _read_numbers(texts[field], count, f"{path}: field {field}")
    return values


def _read_numbers(text: str, count: int, where: str) -> Array:
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError as error:
        raise InputError(f"{where}: {error}; {count} numbers are expected") from error
    if len(numbers) != count or not np.all(np.isfinite(numbers)):
        raise InputError(f"{where}: has {len(numbers)} numbers, {count} finite ones are expected")
    return numbers


def _read_times(path: Path) -> NDArray[np.int64]:
    """Times (n,) in nanoseconds of `YYYY-MM-DD hh:mm:ss.nnnnnnnnn` lines."""
    if not path.is_file():
        raise InputError(f"{path}: timestamps are missing; copy them from the KITTI download")
    times = []
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        text = line.strip()
        if not text:
            continue
        seconds, _, fraction = text.partition(".")
        try:
            since_epoch = datetime.fromisoformat(seconds) - datetime(1970, 1, 1)
            whole = since_epoch.days * 86400 + since_epoch.seconds
            times.append(np.int64(whole * 1_000_000_000 + int(fraction[:9].ljust(9, "0"))))
        except (OverflowError, TypeError, ValueError) as error:  # TypeError: a time with its zone
            raise InputError(
                f"{path}: line {number}: {text!r} is no time of the form 2011-09-26 13:10:51.168593664"
            ) from error
    if len(times) < 2:
        raise InputError(f"{path}: holds {len(times)} timestamps; give a drive of at least 2 frames")
    return check_increasing(np.array(times, dtype=np.int64), path)


def _read_oxts(files: list[Path], times_us: NDArray[np.int64]) -> tuple[Array, StatedAccuracy | None]:
    """IMU poses (n, 4, 4) in a local east-north-up frame, by Mercator projection at the first latitude.

    The velocities that were measured are believed beside the positions, where the files tell how accurate both are, as
    the second value says: positions wander by decimetres, and jitter that looks like acceleration. How the errors of
    velocities go on from one to the next they do not tell, so nothing follows for accelerations.
    """
    rows = np.stack([_read_numbers(read_text(file), OXTS_FIELDS, str(file)) for file in files])
    latitude, longitude, altitude, roll, pitch, yaw = rows[:, :6].T
    scale = EARTH_RADIUS * np.cos(np.radians(latitude[0]))
    east = scale * np.radians(longitude)
    north = scale * np.log(np.tan(np.pi / 4 + np.radians(latitude) / 2))
    positions = np.stack([east, north, altitude], axis=-1)
    positions -= positions[0]
    position_sigma, velocity_sigma = rows[:, 23], rows[:, 24]
    told = bool((position_sigma > 0.0).all() and (velocity_sigma > 0.0).all())
    if told:
        # Fields 8, 7 and 11 of 30 are the velocities east, north and up.
        seconds = np.diff(times_us) * 1e-6
        positions = _fuse(positions, rows[:, [7, 6, 10]], position_sigma, velocity_sigma, seconds)
    rotations = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1)).as_matrix()
    if not told:
        return make_pose(rotations, positions), None
    medians = np.median(position_sigma), np.median(velocity_sigma)
    accuracy = StatedAccuracy(
        f"GPS/IMU: positions to {medians[0]:.3g} m and velocities to {medians[1]:.3g} m/s (medians of its own figures)"
    )
    return make_pose(rotations, positions), accuracy


def _fuse(positions: Array, velocities: Array, position_sigma: Array, velocity_sigma: Array, seconds: Array) -> Array:
    """Positions (n, 3) that agree best with those measured and, over steps of `seconds` (n - 1,), with the velocities.

    Least squares with the standard deviations (n,) of both; velocities are taken as linear over a step.
    """
    steps = 0.5 * (velocities[1:] + velocities[:-1]) * seconds[:, None]
    by_place = position_sigma**-2
    by_step = (0.5 * (velocity_sigma[1:] + velocity_sigma[:-1]) * seconds) ** -2
    normal = np.zeros((2, len(positions)))
    normal[0, 1:] = -by_step
    normal[1] = by_place
    normal[1, :-1] += by_step
    normal[1, 1:] += by_step
    right = by_place[:, None] * positions
    right[1:] += by_step[:, None] * steps
    right[:-1] -= by_step[:, None] * steps
    return np.asarray(solveh_banded(normal, right), dtype=np.float64)


def _align_rig(T_world_imu: Array) -> tuple[Array, bool]:
    """Pose (4, 4) of the IMU in the rig, above its origin, and whether the motion told how it is turned."""
    level = make_pose(np.eye(3), [0.0, 0.0, IMU_HEIGHT])
    aligned = align_mounting(T_world_imu, level)
    return (level, False) if aligned is None else (aligned, True)


def _extended(trajectory: Trajectory) -> Trajectory:
    """The trajectory with one more pose at each end, at constant velocity: images reach beyond the GPS/IMU's times."""
    times, poses = trajectory.timestamps_us, trajectory.T_world_rig
    before = poses[0] @ invert(poses[1]) @ poses[0]
    after = poses[-1] @ invert(poses[-2]) @ poses[-1]
    ends = [2 * times[0] - times[1], 2 * times[-1] - times[-2]]
    return Trajectory(np.concatenate([ends[:1], times, ends[1:]]), np.concatenate([before[None], poses, after[None]]))


def is_drive(path: Path) -> bool:
    """Whether a folder looks like a drive, judged by the names in it."""
    is_flat = (path / "image_02").is_dir() and (path / CAMERA_FILE).is_file()
    return (path / _OFFICIAL_IMAGES).is_dir() or is_flat


DATASET = kitti_reader(NAME, is_drive, KittiRawDrive)
