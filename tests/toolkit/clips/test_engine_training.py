"""Engines trained beside given weights, on clips in the released layout."""

from dataclasses import replace

import pytest
from safetensors.torch import save_file

from olt_generator.diffusion.backbone import build_autoencoder, build_backbone
from olt_generator.diffusion.engine_folder import load_engine
from olt_generator.diffusion.released_cache import ReleasedCache, is_released_cache
from olt_generator.diffusion.training_settings import TrainingSettings
from olt_generator.errors import InputError
from olt_generator.progress import silent
from olt_toolkit.clips.engine_training import Weights, train_on_released
from olt_toolkit.commands.generate_train import train as train_command

from ...generator.diffusion import toy_cache

SETTINGS = TrainingSettings(precision="float32", optimizer=replace(toy_cache.OPTIMIZER, steps=2))


class Silent:
    """A stage that shows nothing."""

    def __init__(self, name):
        self.name = name

    def __enter__(self):
        return silent

    def __exit__(self, *error):
        return None


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    folder = tmp_path_factory.mktemp("released")
    toy_cache.write_released(folder)
    return folder


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Small networks as diffusers writes them, and embeddings of texts."""
    folder = tmp_path_factory.mktemp("weights")
    build_backbone(toy_cache.ENGINE.backbone).save_pretrained(folder / "transformer")
    build_autoencoder(toy_cache.ENGINE.autoencoder).save_pretrained(folder / "vae")
    save_file(dict(zip(("prompt", "empty"), toy_cache.build_texts(), strict=True)), folder / "text.safetensors")
    return Weights(folder, folder / "text.safetensors")


def test_released_clips_are_trained_on(cache, weights, tmp_path):
    engine = train_on_released(ReleasedCache(cache), toy_cache.ENGINE, SETTINGS, tmp_path, 0, Silent, weights)
    loaded = load_engine(engine, weights.backbone)
    assert (loaded.facts.width, loaded.facts.height, loaded.facts.frame_us) == (48, 32, None)
    assert not loaded.facts.owns_backbone
    adapters = [p for name, p in loaded.model.named_parameters() if "lora_B" in name]
    assert adapters and all(bool(p.any()) for p in adapters[:4])


def test_released_clips_need_the_weights_that_made_them(cache, tmp_path):
    released = ReleasedCache(cache)
    with pytest.raises(InputError, match="UMT5 embeddings"):
        train_on_released(released, toy_cache.ENGINE, SETTINGS, tmp_path, 0, Silent, None)
    with pytest.raises(InputError, match="latents of Wan's autoencoder"):
        train_command(tmp_path, data=cache)


def test_released_clips_are_of_one_size(cache, tmp_path):
    assert is_released_cache(cache) and not is_released_cache(tmp_path)
    with pytest.raises(InputError, match="holds no clip_NNNNNN"):
        ReleasedCache(tmp_path)
    toy_cache.write_released(tmp_path)
    for path in sorted(tmp_path.iterdir()):
        path.rename(tmp_path / path.name.replace("000001", "000002"))
    toy_cache.write_released(tmp_path, rows=6)
    both = ReleasedCache(tmp_path)
    assert both.numbers("train") == [0, 1] and both.numbers("unseen") == []
    with pytest.raises(InputError, match="clips of one size"):
        both.clip(1)
