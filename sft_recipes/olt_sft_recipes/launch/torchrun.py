"""The commands of a launch: `torchrun` with its rendezvous, and the words of a shell."""

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from olt_generator.errors import InputError

PORT = 29_500
_HOST = re.compile(r"[\w.-]+(:\d{1,5})?")


@dataclass(frozen=True)
class Machines:
    """Where a launch runs.

    Attributes:
        nodes, gpus: machines, and processes on each.
        head: HOST or HOST:PORT of the machine at which several meet; not needed under SLURM.
    """

    nodes: int = 1
    gpus: int = 8
    head: str | None = None

    def __post_init__(self) -> None:
        if self.head is not None and not _HOST.fullmatch(self.head):
            raise InputError(f"head {self.head!r}: write HOST or HOST:PORT")

    @property
    def devices(self) -> int:
        """Processes of all machines together."""
        return self.nodes * self.gpus

    def rendezvous(self) -> list[str]:
        """Arguments by which the processes of all machines find each other; the same on every machine."""
        if self.nodes == 1:
            return ["--standalone"]
        if self.head is None:
            raise InputError(
                f"{self.nodes} nodes without SLURM need --head HOST[:PORT], one of them, at which they meet"
            )
        endpoint = self.head if ":" in self.head else f"{self.head}:{PORT}"
        return ["--nnodes", str(self.nodes), "--rdzv_backend", "c10d", "--rdzv_endpoint", endpoint]


def training_words(
    torchrun: str, machines: Machines, package: str, config_name: str, entry: str = "train_hf"
) -> list[str]:
    """A `torchrun` of a recipe without its overrides."""
    return [torchrun, *machines.rendezvous(), *recipe_words(machines.gpus, package, config_name, entry)]


def recipe_words(gpus: int, package: str, config_name: str, entry: str) -> list[str]:
    """What follows `torchrun` and its rendezvous."""
    module = [f"{package}.{entry}", "--config-path", f"pkg://{package}/configs", "--config-name", config_name]
    return ["--nproc_per_node", str(gpus), "-m", *module]


def to_shell(words: Sequence[str], indent: str = "    ") -> str:
    """A command for a shell, quoted, an override a line."""
    quoted = [shlex.quote(word) for word in words]
    start = next((index for index, word in enumerate(words) if "=" in word), len(words))
    return f" \\\n{indent}".join([" ".join(quoted[:start]), *quoted[start:]])
