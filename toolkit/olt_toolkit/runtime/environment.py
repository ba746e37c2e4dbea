"""The machine and the versions that a result was made with."""

import os
import platform
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

from olt_generator.version import __version__
from olt_toolkit.runtime.threads import THREAD_VARIABLES
from olt_toolkit.runtime.workers import default_workers

CORE_PACKAGES = ("torch", "casadi", "opencv-contrib-python-headless", "usd-core", "numpy", "scipy", "av")

# What each extra of the distribution enables; which packages it takes stands in the distribution's metadata.
OPTIONAL_PARTS = {
    "learned": "networks in local folders: depth, matching, Wan2.1-VACE",
    "devkit": "reading clips with the public devkit",
    "distributed": "building clips on more than one machine",
}


def package_version(package: str) -> str | None:
    """Installed version of a distribution, None when it is absent."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def describe_machine() -> dict[str, Any]:
    """Processor, memory, system and versions: what stands beside every measured number."""
    return {
        "processor": _processor_name(),
        "cores": default_workers(),
        "memory_gib": _memory_gib(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": platform.python_version(),
        "openlongtail": __version__,
        "packages": {package: package_version(package) for package in CORE_PACKAGES},
        "threads": {variable: os.environ.get(variable) for variable in THREAD_VARIABLES},
    }


def describe_optional_parts() -> list[dict[str, Any]]:
    """For every optional part: what it enables, whether it is complete, and what is missing."""
    parts = []
    for name, enables in OPTIONAL_PARTS.items():
        missing = [package for package in _packages_of("openlongtail", name) if package_version(package) is None]
        parts.append({"name": name, "enables": enables, "present": not missing, "missing": missing})
    return parts


def _packages_of(distribution: str, extra: str) -> Iterator[str]:
    """The packages that an extra takes, those of the extras of other distributions included."""
    for line in requires(distribution) or ():
        package, _, others = re.findall(r"([\w.-]+)(\[([\w,-]+)\])?", line)[0]
        if re.search(rf"extra == .{extra}\b", line):
            yield package
            for other in filter(None, others.split(",")):
                yield from _packages_of(package, other)


def _processor_name() -> str:
    with suppress(OSError):
        if found := re.search(r"^model name\s*:(.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE):
            return found[1].strip()
    return platform.processor() or sys.platform


def _memory_gib() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (ValueError, OSError):
        return None
