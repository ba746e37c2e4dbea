"""Which frame a rear view looks back to."""

from olt_generator.views.lookback import LOOKBACK_LATENTS, lookback_frame


def test_offsets_are_those_of_the_rear_views():
    assert LOOKBACK_LATENTS == {
        "camera_rear_left_70fov": 4,
        "camera_rear_right_70fov": 4,
        "camera_rear_tele_30fov": 6,
    }


def test_frames_of_the_last_latent_look_back_to_frame_23():
    assert [lookback_frame(frame, 4) for frame in (37, 38, 39, 40)] == [23] * 4
    assert lookback_frame(40, 6) == 15


def test_the_start_looks_back_to_the_first_frame():
    assert [lookback_frame(frame, 4) for frame in (0, 1, 8, 16)] == [0, 0, 0, 0]
    assert lookback_frame(17, 4) == 3
