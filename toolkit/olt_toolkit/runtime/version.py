"""Which code made a result."""

import hashlib
from functools import cache
from pathlib import Path

from olt_generator.version import __version__

_HASHED = (".py", ".yaml")


@cache
def code_version() -> str:
    """What tells this code from any other, such as `0.2.0` or, out of a checkout, `0.2.0+source.3f2a9c01d4e5`.

    An installed distribution is told by its version. The source in a checkout may be edited at any time, so a hash of
    its contents is added: the same source has the same one on every machine.
    """
    root = Path(__file__).resolve().parents[3]
    return f"{__version__}+source.{hash_source(root)}" if (root / "pyproject.toml").is_file() else __version__


def hash_source(root: Path) -> str:
    """BLAKE2b (6 bytes, hexadecimal) of names and contents of the packages' code and settings in a checkout."""
    digest = hashlib.blake2b(digest_size=6)
    packages = [*root.glob("[a-z]*/olt_*"), *root.glob("[a-z]*/[a-z]*/olt_*")]
    for path in sorted(path for package in packages for path in package.rglob("*") if path.suffix in _HASHED):
        data = path.read_bytes()
        digest.update(f"{path.relative_to(root).as_posix()}\x1f{len(data)}\x1f".encode())
        digest.update(data)
    return digest.hexdigest()
