"""What the log of a recipe says: how far it is, and the faults that it does not stop for itself.

The lines are those of NVlabs/alpamayo-recipes and of the Trainer of transformers 4.57 at log level "info"
(docs/formats/sft_recipes.md).
"""

import math
import re
from dataclasses import dataclass, field

from olt_generator.errors import InputError
from olt_sft_recipes.launch.public_recipes import Stage
from olt_sft_recipes.toy.tokens import FUTURE_BINS

UNIFORM_LOSS = math.log(FUTURE_BINS)
"""Cross-entropy of one that knows nothing of the 3,000 future tokens and guesses: 8.006."""

_CHUNKS = re.compile(r"Loading from (?P<folder>.*?) with chunk_ids: (?P<chunks>\[[\d, ]*\]|None)")
# What is held against the plan, where the log tells it.
_TOLD = ("chunks", "samples", "steps", "trained parameters", "losses")
_COUNTS = {
    "samples": re.compile(r"Num examples = ([\d,]+)"),
    "steps": re.compile(r"Total optimization steps = ([\d,]+)"),
    "trained parameters": re.compile(r"Number of trainable parameters = ([\d,]+)"),
}
# Processes write into each other's lines, so that anything may stand around a dictionary, or in it.
_LOGGED = re.compile(r"\{'loss': [^{}]*\}")
_NUMBER = r"(-?(?:nan|inf|\d+(?:\.\d*)?(?:e[+-]?\d+)?))"
_VALUE = re.compile(rf"'(\w+)': (?:np\.float\d+\()?{_NUMBER}\)?(?=[,}}])", re.IGNORECASE)
_METRIC = re.compile(rf"val/(\S+)\s+{_NUMBER}\s*$", re.IGNORECASE)
_BAR = re.compile(r"\s(\d+)/(\d+) \[")


@dataclass(frozen=True)
class Expected:
    """What the log must say.

    Attributes:
        stage: 1 or 2.
        folder, chunks: `local_dir` of the training data and the chunk numbers of its range.
        validation_chunks: those of validation, where it is the same folder.
        samples, steps: of the training.
        trained: parameters that the stage trains; None where they were not counted.
    """

    stage: Stage
    folder: str
    chunks: range
    samples: int
    steps: int
    trained: int | None = None
    validation_chunks: range | None = None


@dataclass
class LogWatch:
    """Takes a log line by line; `see` raises `InputError` at a line that shows a silent failure.

    Attributes:
        step, steps: optimizer steps that are done, and all.
        losses: those that were logged, with their epochs.
        seen: counts that the log told, by name.
        metrics: of an evaluation, by name.
    """

    expected: Expected
    step: int = 0
    losses: list[tuple[float, float]] = field(default_factory=list)
    seen: dict[str, int] = field(default_factory=dict)
    metrics: dict[str, float] = field(default_factory=dict)

    @property
    def share(self) -> float:
        """Part of the training that is done, 0 to 1."""
        return min(1.0, self.step / max(self.expected.steps, 1))

    def see(self, line: str) -> None:
        """Take one line.

        Raises:
            InputError: no clip or others were selected, samples or steps are not those of the arithmetic, more is
                trained than should be, a loss is not finite, or the first one shows that nothing is learned from or
                that tokens mean something else to the model.
        """
        self._see_chunks(line)
        for name, pattern in _COUNTS.items():
            if match := pattern.search(line):
                self._see_count(name, int(match[1].replace(",", "")))
        for match in _LOGGED.finditer(line):
            self._see_loss({name: float(value) for name, value in _VALUE.findall(match[0])})
        if (match := _BAR.search(line)) and int(match[2]) == self.expected.steps:
            self.step = max(self.step, int(match[1]))

    def unseen(self) -> list[str]:
        """What the log never told, so that nothing was held against it."""
        return [name for name in _TOLD if name not in self.seen]

    def _see_chunks(self, line: str) -> None:
        if "Invalid chunk_ids" in line:
            raise InputError(f"the recipe did not understand its range of chunks: {line.strip()}")
        match = _CHUNKS.search(line)
        if match is None or match["folder"].strip() != self.expected.folder:
            return
        chunks = [int(number) for number in re.findall(r"\d+", match["chunks"])]
        if not chunks:
            raise InputError(
                f"the recipe selected no chunk of {match['folder']}, so no clip: a range is FIRST-END with END left "
                "out, and a text without a dash selects nothing"
            )
        self.seen["chunks"] = len(chunks)
        meant = (self.expected.chunks, self.expected.validation_chunks or ())
        if chunks not in [list(each) for each in meant]:
            first, last = self.expected.chunks[0], self.expected.chunks[-1]
            raise InputError(
                f"the recipe selected chunks {min(chunks)} to {max(chunks)} of {match['folder']}, not {first} to {last}"
            )

    def _see_count(self, name: str, count: int) -> None:
        self.seen[name] = count
        if name == "trained parameters":
            limit = self.expected.trained
            # A shard of ZeRO counts itself alone on some versions: fewer is told, more is a fault.
            if limit is not None and count > 1.001 * limit:
                raise InputError(
                    f"{count:,} parameters are trained, and Stage {self.expected.stage} should train {limit:,}: "
                    + ("the vision-language model is not frozen" if self.expected.stage == 2 else "see the table")
                )
            return
        wanted = getattr(self.expected, name)
        if count == 0:
            raise InputError("the recipe found no clip to train on (Num examples = 0): look at local_dir and chunk_ids")
        if count != wanted:
            raise InputError(
                f"the recipe counts {count:,} {name}, and the data and settings make {wanted:,}: it does not train on "
                "what was exported, or not on as many processes"
            )

    def _see_loss(self, logged: dict[str, float]) -> None:
        for name in ("loss", "grad_norm"):
            if not math.isfinite(value := logged.get(name, 0.0)):
                raise InputError(f"{name} is {value} at epoch {logged.get('epoch')}: nothing after it can be used")
        if "loss" not in logged:  # garbled
            return
        if not self.losses and self.expected.stage == 1:
            self._check_first(logged["loss"])
        self.seen["losses"] = len(self.losses) + 1
        self.losses.append((logged.get("epoch", 0.0), logged["loss"]))

    def _check_first(self, loss: float) -> None:
        if loss == 0.0:
            raise InputError("the first loss is 0: no token is labelled, so nothing is learned; look at the prompt")
        if loss >= UNIFORM_LOSS:
            raise InputError(
                f"the first loss is {loss:.3g}, no better than guessing among {FUTURE_BINS} tokens "
                f"({UNIFORM_LOSS:.3g}); a released model starts at 1.6 to 1.7: its trajectory tokens have other "
                "ids (a mixed-up offset: future tokens are <i0> to <i2999>, those of the history follow), or "
                "it is not the released model"
            )

    def see_metric(self, line: str) -> None:
        """Take a line of the evaluation."""
        if match := _METRIC.search(line):
            self.metrics[match[1]] = float(match[2])
