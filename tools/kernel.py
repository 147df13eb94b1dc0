"""What the kernel says about this process (Linux)."""

from __future__ import annotations

from pathlib import Path


def memory_mb(name: str) -> float:
    """Return a memory figure, shared memory included: `VmRSS`, what is resident now, or `VmHWM`, its peak.

    Raises:
        OSError: The system has no such figure.
    """
    return _figure(Path("/proc/self/status"), name) / 1024  # it counts in kB


def bytes_read() -> int:
    """Return how many bytes this process has read so far, from files or the page cache; mapped files do not count.

    Raises:
        OSError: The system does not count them.
    """
    return _figure(Path("/proc/self/io"), "rchar")


def _figure(path: Path, name: str) -> int:
    for line in path.read_text(encoding="ascii").splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1])
    raise OSError(f"{path} has no {name}: this can only be measured on Linux")
