"""What moves as the camera says is more probable than what does not."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.poses import invert, planar_pose, transform
from olt_toolkit.clips.verification.flow_likelihood import (
    INVERSE_DISTANCES,
    distance_weights,
    log_likelihood,
    odds_on_lens,
    place_spread,
)
from olt_toolkit.rigs.rig import FRONT_WIDE
from olt_toolkit.rigs.rig_files import pav_rig

CAMERA = pav_rig().fitted(480, 270)[FRONT_WIDE]
SCALE = float(np.mean(CAMERA.camera.pixels_per_radian))


def likelihood_of(said, true, count=300):
    """Log-likelihood (count,) of points that moved as `true` (4, 4) if the rig is said to have moved as `said`."""
    generator = np.random.default_rng(0)
    points_rig = np.stack(
        [generator.uniform(6, 60, count), generator.uniform(-15, 15, count), generator.uniform(0, 8, count)], axis=1
    )
    points_rig[: count // 2, 2] = 0.0
    T = CAMERA.T_rig_camera
    before, after = transform(invert(T), points_rig), transform(invert(true @ T), points_rig)
    pixels, moved = (CAMERA.camera.project(points)[0] for points in (before, after))
    rays, rays_moved = (CAMERA.camera.rays(places) for places in (pixels, moved))
    way = np.linalg.norm(moved - pixels, axis=1)
    spread = place_spread(way, SCALE)
    steps = np.repeat((invert(T) @ said @ T)[None], count, axis=0)
    weights = distance_weights(rays @ T[:3, :3].T, float(T[2, 3]))
    return log_likelihood(
        rays, rays_moved, steps, weights, np.stack([spread / SCALE, spread], axis=1), odds_on_lens(way)
    )


@settings(max_examples=25, deadline=None)
@given(st.floats(0.5, 2.5), st.floats(-0.06, 0.06))
def test_the_true_motion_wins(way, turn):
    true = planar_pose(way, 0.5 * way * turn, turn)
    won = likelihood_of(true, true).mean()
    assert won > likelihood_of(invert(true), true).mean() + 0.2
    assert won > likelihood_of(planar_pose(4.0 * way, 2.0 * way * turn, turn), true).mean() + 0.1
    assert won > likelihood_of(planar_pose(way, 0.5 * way * turn, turn + 0.08), true).mean() + 0.2


def test_weights_are_probabilities_and_know_the_road():
    rays = CAMERA.camera.rays(np.array([[240.0, 20.0], [240.0, 190.0], [100.0, 260.0]])) @ CAMERA.T_rig_camera[:3, :3].T
    weights = distance_weights(rays, 1.443)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-5)
    down = -rays[2, 2]
    assert INVERSE_DISTANCES[weights[2].argmax()] == np.float64(
        INVERSE_DISTANCES[np.abs(INVERSE_DISTANCES - down / 1.443).argmin()]
    )
