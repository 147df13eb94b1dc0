"""Read recordings in every way there is. Run as a program it prints what came of each file, and what it took.

python -m tests.support.every_read FILE...
"""

from __future__ import annotations

import ctypes
import gc
import json
import resource
import sys
import time
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

from ml_dash_mcap import Recording
from ml_dash_mcap.errors import DamagedFileError, NotFoundError

RSS_UNITS_A_MB = 1024 * 1024 if sys.platform == "darwin" else 1024

WORTH_S = 0.3
"""Files that take longer to read once are not read in every way."""


def everything(rec: Recording) -> None:
    """Ask for everything that can be asked for."""
    for topic in rec.topics:
        reader = rec[topic]
        for _ in reader.batches(rows=1000):
            pass
        for _ in reader.rows(0.0, 1.0, start_index=1, limit=2):
            pass
        reader.to_arrow(0.0, 5e-8)
        assert len(reader) >= 0
        assert reader.info.bytes >= 0
        assert repr(reader)
        with suppress(NotFoundError):
            reader.last()
        with suppress(NotFoundError):
            reader.at(1.0)
        for name in ("json", "jsonl", "parquet", "mcap"):
            reader.read(0.0, 5e-8, format=name)
    assert rec.duration >= 0
    assert repr(rec)
    assert rec.check() is not None
    assert isinstance([rec.metadata, rec.params, rec.run, rec.logs, rec.files, dict(rec.metrics)], list)
    for attachment in rec.attachments.list():
        with suppress(DamagedFileError):  # each is checked on its own, whatever was asked for
            attachment.read()


def outcome(path: Path, on_damage: str, *, whole: bool = True) -> str:
    """What comes of reading a file: "read", or what was raised."""
    try:
        with Recording(path, on_damage=on_damage) as rec:
            for topic in rec.topics:
                for _ in rec[topic].rows():  # without keeping them
                    pass
            if whole:
                everything(rec)
    except DamagedFileError as error:
        return "refused" if error.path == path else f"the error names {error.path}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "read"


def peak_mb() -> float:
    """Return the most memory that was resident, of this program alone: Linux counts in what its parent had at its fork."""
    status = Path("/proc/self/status")
    if status.exists():
        (peak,) = [line for line in status.read_text().splitlines() if line.startswith("VmHWM:")]
        return int(peak.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / RSS_UNITS_A_MB


def _give_back() -> None:
    """Let the system have the memory that earlier files took and left, which says nothing about the next one."""
    gc.collect()
    with suppress(AttributeError, OSError):  # another C library than glibc
        ctypes.CDLL(None).malloc_trim(0)


def main(paths: list[Path]) -> None:
    """Print a line of JSON for each file."""
    warnings.simplefilter("ignore")
    for path in paths:
        _give_back()
        said: dict[str, Any] = {"name": path.stem}
        for on_damage in ("raise", "skip"):
            begun = time.process_time()
            said[on_damage] = outcome(path, on_damage, whole=False)
            said[f"{on_damage}_s"] = time.process_time() - begun
            if said[f"{on_damage}_s"] < WORTH_S:
                said[on_damage] = outcome(path, on_damage)
        said["peak_mb"] = peak_mb()
        print(json.dumps(said), flush=True)


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
