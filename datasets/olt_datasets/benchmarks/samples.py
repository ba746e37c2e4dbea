"""Training samples of 4 cameras x 4 frames at 320 x 576: our loader against the public devkit on the same clips."""

import tempfile
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_datasets import contents_of_stores, export_pai
from olt_generator import InputError, Trajectory
from olt_generator.files import write_whole_folder
from olt_generator.poses import planar_pose
from olt_generator.seeds import make_generator
from olt_toolkit import ClipStore, SampleKey, __version__
from olt_toolkit.bench.benchmark import Benchmark, Setting
from olt_toolkit.clips.clip import CameraStream, Clip, ClipOrigin, EgoMotion, ViewProvenance, make_clip_id
from olt_toolkit.policy.window import IMAGE_OFFSETS_US
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, POLICY_CAMERAS
from olt_toolkit.rigs.rig_files import pav_rig

IMAGE_SIZE = (320, 576)
CLIP_ID = make_clip_id("samples benchmark")
FIRST_IMAGE_US, FRAMES, FRAME_RATE = 1_500_000, 60, 30
T0S_US = (2_000_000, 2_300_000, 2_900_000, 3_200_000)
REVISION = "0" * 40
SIZES = ((1920, 1080), (576, 320))

Images = NDArray[np.uint8]
Judged = tuple[tuple[int, int], Images]
"""Size of the clip's images, and the sample images (4 samples, 4 cameras, 4 frames, 3, 320, 576)."""


@lru_cache(maxsize=2)
def exported_clip(width: int, height: int) -> Path:
    """An exported folder with one clip of the given size; made once and kept in the system's temporary folder."""
    folder = Path(tempfile.gettempdir()) / f"olt-bench-samples-{__version__}-{width}x{height}"
    if not folder.is_dir():
        with write_whole_folder(folder) as temporary:
            store = ClipStore(temporary / "store")
            store.prepare(make_clip(width, height))
            store.commit([CLIP_ID])
            export_pai(contents_of_stores([store.root], "train"), temporary / "pai")
    return folder / "pai"


def make_clip(width: int, height: int) -> Clip:
    """Two seconds of four cameras at 30 Hz within 12 s of ego motion: textures that move, with grain as of a sensor."""
    ego_us = 20_000 * np.arange(600, dtype=np.int64)
    still = np.zeros(len(ego_us))
    motion = EgoMotion.from_trajectory(Trajectory(ego_us, planar_pose(10e-6 * ego_us, still, still)))
    image_us = FIRST_IMAGE_US + np.arange(FRAMES, dtype=np.int64) * 1_000_000 // FRAME_RATE
    rig = pav_rig().fitted(width, height)
    frames = make_frames(width, height)
    streams = {
        name: CameraStream(frames, image_us, FRAME_RATE, rig[name].camera, rig[name].T_rig_camera)
        for name in POLICY_CAMERAS
    }
    return Clip(
        clip_id=CLIP_ID,
        name="samples benchmark",
        scene_id="samples benchmark",
        source="benchmark",
        origin=ClipOrigin("samples benchmark", int(image_us[0]), int(image_us[-1])),
        kind="GT",
        category="nominal",
        factors=(),
        split="train",
        streams=streams,
        ego_motion=motion,
        vehicle=DEFAULT_VEHICLE,
        provenance={name: ViewProvenance("rendered", "benchmark", "1", 0, 1.0, 0.0) for name in streams},
    )


def make_frames(width: int, height: int) -> Images:
    """Frames (60, H, W, 3) cut at a moving place from a texture with as much contrast in every octave of size."""
    random = make_generator("samples benchmark")
    step = max(1, width // 640)
    texture = np.full((height, width + FRAMES * step, 3), 128.0, np.float32)
    for octave in range(2, 9):
        size = ((texture.shape[0] >> octave) + 2, (texture.shape[1] >> octave) + 2, 3)
        grid = random.normal(0.0, 10.0, size).astype(np.float32)
        texture += np.asarray(cv2.resize(grid, texture.shape[1::-1], interpolation=cv2.INTER_CUBIC), np.float32)
    grain = random.normal(0.0, 1.5, (4, height, width, 1)).astype(np.float32)
    frames = np.empty((FRAMES, height, width, 3), np.uint8)
    for index, frame in enumerate(frames):
        frame[:] = np.clip(texture[:, index * step : index * step + width] + grain[index % len(grain)], 0, 255)
    return frames


def prepare_ours(size: tuple[int, int], together: bool) -> Callable[[], Judged]:
    """Our loader: every sample by itself, or all samples of the clip in one pass through its videos."""
    store = ClipStore(exported_clip(*size))
    keys = [SampleKey(str(store.root), CLIP_ID, t0_us) for t0_us in T0S_US]

    def load() -> Judged:
        batches = [keys] if together else [[key] for key in keys]
        samples = [sample for batch in batches for sample in store.load_samples(batch, IMAGE_SIZE)]
        return size, np.stack([sample.image_frames for sample in samples])

    return load


def prepare_devkit(size: tuple[int, int]) -> Callable[[], Judged]:
    """The public devkit (else InputError) as the public recipes use it, offline, scaling images by area averaging."""
    try:
        import huggingface_hub.constants
        from physical_ai_av import PhysicalAIAVDatasetInterface
    except ImportError as error:
        raise InputError("physical-ai-av is not installed; install the extra `interop`") from error
    # It reads a hub cache only, so a cache is made that points to the folder.
    cache = Path(tempfile.mkdtemp(prefix="olt-devkit-"))
    snapshots = cache / "datasets--nvidia--PhysicalAI-Autonomous-Vehicles" / "snapshots"
    snapshots.mkdir(parents=True)
    (snapshots / REVISION).symlink_to(exported_clip(*size), target_is_directory=True)
    huggingface_hub.constants.HF_HUB_OFFLINE = True
    devkit = PhysicalAIAVDatasetInterface(REVISION, cache_dir=cache, token=False)

    def load_sample(t0_us: int) -> Images:
        devkit.get_clip_feature(CLIP_ID, "egomotion")(t0_us + IMAGE_OFFSETS_US)
        readers = [devkit.get_clip_feature(CLIP_ID, name) for name in POLICY_CAMERAS]
        frames = [reader.decode_images_from_timestamps(t0_us + IMAGE_OFFSETS_US)[0] for reader in readers]
        return np.stack([[shrink(frame) for frame in camera] for camera in frames])

    return lambda: (size, np.stack([load_sample(t0_us) for t0_us in T0S_US]))


def shrink(frame: Images) -> Images:
    """An image (H, W, 3) as planes (3, 320, 576), by area averaging where it is larger."""
    height, width = IMAGE_SIZE
    if frame.shape[:2] != IMAGE_SIZE:
        frame = np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    return frame.transpose(2, 0, 1)


@lru_cache(maxsize=2)
def reference(size: tuple[int, int]) -> Images:
    """Every frame decoded at full size, then scaled in floating point."""
    store = ClipStore(exported_clip(*size))
    height, width = IMAGE_SIZE
    samples = []
    for t0_us in T0S_US:
        cameras = [store.read_frames(CLIP_ID, name, t0_us + IMAGE_OFFSETS_US)[0] for name in POLICY_CAMERAS]
        scaled = [
            [cv2.resize(frame.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) for frame in camera]
            for camera in cameras
        ]
        samples.append(np.array(scaled).transpose(0, 1, 4, 2, 3))
    return np.stack(samples)


def measure_error(judged: Judged) -> float:
    """Root mean square difference from the reference in grey levels."""
    size, images = judged
    return float(np.sqrt(np.mean((images - reference(size)) ** 2)))


def _settings() -> Sequence[Setting]:
    settings = []
    for size in SIZES:
        clip = f"{size[0]} x {size[1]} clip"
        settings += [
            Setting(f"devkit, {clip}", partial(prepare_devkit, size)),
            Setting(f"ours, sample by sample, {clip}", partial(prepare_ours, size, together=False)),
            Setting(
                f"ours, the clip's samples together, {clip}",
                partial(prepare_ours, size, together=True),
                default=size == SIZES[0],
            ),
        ]
    return settings


BENCHMARK = Benchmark(
    title=f"{len(T0S_US)} samples of one exported clip, 4 cameras x 4 frames at 320 x 576, one thread",
    error_name="rms error",
    error_unit="grey levels",
    reference="frames decoded at full size, then averaged over the area of each new pixel in floating point",
    settings=_settings,
    measure_error=measure_error,
)
