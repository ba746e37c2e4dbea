"""How far a recovered motion may be from the true one: of the metric scale, and of every pose.

Scale. The road below a camera of height h moves through the image of a lens of focal length f by f h / z^2 pixels for
every metre driven, z being how far ahead it lies, and z itself is read off the image as f h over the pixels below the
horizon. So what was measured in pixels becomes metres by f times h: each of them stretches the motion by as much as it
is off, one to one. They err independently of each other and of how well the road was followed, so that the relative
variances add.

Poses. An estimate's covariance is that of the path's shape at the scale as it was found. A scale that is off by a share
s moves a position p, seen from the first pose, by s p, which adds sigma^2 p p^T; rotations stay.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from olt_generator.camera_spread import CameraSpread
from olt_generator.motion.pose_sources import PoseEstimate
from olt_generator.poses import Array, make_pose
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_generator.twists import cross_matrix, rotation_from_vector


@dataclass(frozen=True)
class ScaleUncertainty:
    """Relative standard deviations of the metric scale, part by part.

    Attributes:
        road: of the fit to the video, by the estimator's own account; None where it does not know.
        camera: of the camera's height and focal length, with where each comes from.
    """

    road: float | None
    camera: CameraSpread

    @property
    def total(self) -> float | None:
        """All parts together; None where the estimator does not know its own."""
        if self.road is None:
            return None
        return float(np.sqrt(self.road**2 + self.camera.height.relative**2 + self.camera.focal_length.relative**2))

    def to_dict(self) -> dict[str, Any]:
        """Plain values: total, and each part with its origin."""
        return {"total": self.total, "road": {"relative": self.road, "origin": "estimated"}, **asdict(self.camera)}


def total_covariance(estimate: PoseEstimate, scale: ScaleUncertainty) -> Array | None:
    """Covariances (n, 6, 6) as of `PoseEstimate.covariance`, that of the scale with them; None where a part is unknown.

    A vehicle that stays where it is has no use for a scale.
    """
    covariance, sigma = estimate.covariance, scale.total
    if covariance is None:
        return None
    positions = estimate.trajectory.in_first_frame().positions
    if sigma is None:
        return None if positions.any() else covariance
    total = covariance.copy()
    total[:, :3, :3] += sigma**2 * positions[:, :, None] * positions[:, None, :]
    return total


def camera_covariance(covariance: Array, trajectory: Trajectory, T_rig_camera: Array) -> Array:
    """Covariances (n, 6, 6) of the camera's poses in the axes of its first one, from those of the rig's.

    A rotation error t moves a camera that is mounted at l by t x (R l), with R the rotation since the first pose.
    """
    rotations = trajectory.in_first_frame().T_world_rig[:, :3, :3]
    jacobian = np.zeros((len(rotations), 6, 6))
    R_camera_rig = T_rig_camera[:3, :3].T
    jacobian[:, :3, :3] = jacobian[:, 3:, 3:] = R_camera_rig
    jacobian[:, :3, 3:] = -R_camera_rig @ cross_matrix(rotations @ T_rig_camera[:3, 3])
    return jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)


def draw_estimates(estimate: PoseEstimate, draws: int) -> list[Trajectory]:
    """Trajectories as likely as the estimate, by its covariance, with errors that grow from pose to pose.

    A covariance of each pose does not tell how errors hang together in time. Odometry adds motion to motion, so each
    step is taken to add an error of its own to what has come before, which is carried on: an error of rotation bends
    the rest of the path. Of errors that all poses share, such as one of the scale, no label would show a trace.

    Raises:
        ValueError: the covariance is not known.
    """
    if estimate.covariance is None:
        raise ValueError("the covariance of the estimate is not known")
    trajectory = estimate.trajectory.in_first_frame()
    carry = np.tile(np.eye(6), (len(trajectory) - 1, 1, 1))
    carry[:, :3, 3:] = -cross_matrix(np.diff(trajectory.positions, axis=0))
    covariance = estimate.covariance
    added = covariance[1:] - carry @ covariance[:-1] @ np.swapaxes(carry, -1, -2)
    values, vectors = np.linalg.eigh(added)
    # What a step takes away again, as where a place is seen once more, is not drawn.
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    white = make_generator("errors of poses").standard_normal((len(trajectory) - 1, 6, draws))
    errors = np.zeros((len(trajectory), 6, draws))
    for step in range(len(trajectory) - 1):
        errors[step + 1] = carry[step] @ errors[step] + roots[step] @ white[step]
    poses = trajectory.T_world_rig
    return [
        Trajectory(
            trajectory.timestamps_us,
            make_pose(
                rotation_from_vector(errors[:, 3:, draw]) @ poses[:, :3, :3], poses[:, :3, 3] + errors[:, :3, draw]
            ),
        )
        for draw in range(draws)
    ]
