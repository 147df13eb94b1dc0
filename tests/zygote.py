"""A process that has the library loaded and forks one child a request: real processes, made in milliseconds."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import traceback
from types import TracebackType
from typing import Any

PRELOADED = ("ml_dash_mcap.recorder", "ml_dash_mcap.recording", "tests.workload", "tests.faulty_os")


class Zygote:
    """The tests' end of it."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-X", "faulthandler", "-m", "tests.zygote"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def fork(self, function: str, *args: Any) -> int:
        """Start a child that calls a function; returns its process id.

        Args:
            function: As `module:name`.
            *args: As JSON can say them.
        """
        return int(self._ask({"function": function, "args": args}))

    def wait(self, pid: int) -> int:
        """Wait for a child; returns its exit code, or minus the signal that killed it."""
        return int(self._ask({"wait": pid}))

    def run(self, function: str, *args: Any) -> int:
        """Fork and wait."""
        return self.wait(self.fork(function, *args))

    def _ask(self, request: dict[str, Any]) -> Any:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def __enter__(self) -> Zygote:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


def _serve() -> None:
    for name in PRELOADED:
        importlib.import_module(name)
    for line in sys.stdin:
        request = json.loads(line)
        if "wait" in request:
            answer = os.waitstatus_to_exitcode(os.waitpid(request["wait"], 0)[1])
        else:
            answer = os.fork()
            if answer == 0:
                _be_the_child(request["function"], request["args"])
        print(json.dumps(answer), flush=True)


def _be_the_child(function: str, args: list[Any]) -> None:
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    module, _, name = function.partition(":")
    try:
        getattr(importlib.import_module(module), name)(*args)
    except BaseException:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


if __name__ == "__main__":
    _serve()
