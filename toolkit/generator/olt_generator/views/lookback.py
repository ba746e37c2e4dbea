"""The temporal lookback warp of the paper: rear views see what the front camera saw a fixed time earlier.

Paper, section Extrapolative Synthesis: K_t inv(T_cam(t, tau)) T_cam(0, tau - Delta_t) inv(K_0) u d_0(u, tau - Delta_t).
Offsets and latent frames are those of the released generator (docs/formats/generator.md).
"""

# Latent frame n >= 1 of the video autoencoder holds the frames 4 n - 3 to 4 n; frame 0 stands alone.
FRAMES_PER_LATENT = 4
# Latent frames between a view and what it looks back to, by camera.
LOOKBACK_LATENTS: dict[str, int] = {
    "camera_rear_left_70fov": 4,
    "camera_rear_right_70fov": 4,
    "camera_rear_tele_30fov": 6,
}


def lookback_frame(frame: int, offset: int) -> int:
    """The front frame that a rear view of `frame` is warped from: the last but one, `offset` latent frames back.

    Near the start of the clip it is frame 0.
    """
    latent = max(0, -(-frame // FRAMES_PER_LATENT) - offset)
    return max(0, FRAMES_PER_LATENT * latent - 1)
