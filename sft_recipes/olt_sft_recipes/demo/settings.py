"""How large the main job is."""

from dataclasses import dataclass

from olt_closed_loop.scenes.procedural import CATEGORIES

NOMINAL = "nominal"
LONG_TAIL: tuple[str, ...] = tuple(category for category in CATEGORIES if category != NOMINAL)

# Scene seeds of the three roles are disjoint ranges, so no evaluated road is ever trained on.
TRAINING_SEEDS, VALIDATION_SEEDS, EVALUATION_SEEDS, INPUT_SEED = 0, 1000, 2000, 3000


@dataclass(frozen=True)
class DemoSettings:
    """Sizes of the main job; with the defaults it takes four to five minutes on two cores.

    Of the training clips only those frames are made that their samples show (`BuildOptions.frames`).

    Attributes:
        seed: the one seed from which every other follows.
        nominal_clips: ordinary drives with all cameras real (GT), for training.
        long_tail_clips: long-tail drives per category whose side views are synthesized (Syn), for training.
        validation_clips: ordinary drives held out of training, for open-loop errors.
        evaluation_scenes: held-out long-tail scenes per category that the policies drive in closed loop.
        rollouts: closed-loop rollouts per scene and policy.
        frame_rate: frames per second of the synthetic drives.
        video_seconds: how much of a given video is used, from its start.
        input_size: height and width of the synthetic input video and of the views made from the input.
        training_front_size: height and width of the front videos behind the training clips.
        training_size: height and width of the training clips.
    """

    seed: int = 0
    nominal_clips: int = 8
    long_tail_clips: int = 2
    validation_clips: int = 1
    evaluation_scenes: int = 1
    rollouts: int = 2
    frame_rate: float = 10.0
    video_seconds: float = 14.0
    input_size: tuple[int, int] = (270, 480)
    training_front_size: tuple[int, int] = (144, 256)
    training_size: tuple[int, int] = (64, 112)
