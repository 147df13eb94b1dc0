"""Kill a recording process in the middle of its loop, and read back every row that its append returned for."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from ml_dash_mcap import Recorder, Recording


def record(folder: str) -> None:
    """Append rows until killed; say the number of each one after its append has returned."""
    robot = Recorder(folder).topic("robot")
    for number in range(10_000_000):
        robot.append(number=number, q=[0.1] * 7, _ts=number / 1000)
        os.write(1, b"%d\n" % number)


def main() -> None:
    folder = Path(".dash/examples/survive-a-crash") / str(os.getpid())
    with subprocess.Popen([sys.executable, __file__, str(folder)], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        said = [int(child.stdout.readline()) for _ in range(5000)]
        child.kill()  # SIGKILL: nothing of the child runs after this
        said += [int(line) for line in child.stdout.read().splitlines(keepends=True) if line.endswith(b"\n")]
    print(f"the child was killed (exit code {child.returncode}) after it had said {said[-1] + 1} rows")
    print(f"in its folder it left {sorted(path.name for path in folder.iterdir())}")

    with Recording(folder) as recording:  # folds in what waited in the journal
        numbers = [row["number"] for row in recording["robot"].rows()]
        print(f"read back {len(numbers)} rows in {len(recording.segments)} segment(s)")
    assert numbers == list(range(len(numbers))), "a row is missing, or there twice"
    print(f"every row that the child had said is there: {len(numbers) > said[-1]}")


if __name__ == "__main__":
    record(sys.argv[1]) if len(sys.argv) > 1 else main()
