"""The temporal lookback warp of the paper: rear views see what the front camera saw a fixed time earlier.

Paper, section Extrapolative Synthesis: K_t inv(T_cam(t, tau)) T_cam(0, tau - Delta_t) inv(K_0) u d_0(u, tau - Delta_t).
The offsets are those of the released generator (docs/formats/generator.md).
"""

from olt_generator.views.latents import frame_of_latent, latent_of_frame

# Latent frames between a view and what it looks back to, by camera; one latent frame is four video frames.
LOOKBACK_LATENTS: dict[str, int] = {
    "camera_rear_left_70fov": 4,
    "camera_rear_right_70fov": 4,
    "camera_rear_tele_30fov": 6,
}


def lookback_frame(frame: int, offset: int) -> int:
    """The front frame that a rear view of `frame` is warped from, `offset` latent frames back.

    Near the start of the clip it is frame 0.
    """
    return int(frame_of_latent(max(0, latent_of_frame(frame) - offset), "lookback"))
