"""The command line: each command parses, calls one public function, and prints."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from ..errors import FormatError, OptionError, RangeError, UsageError
from . import parser

DONE, FAILED, MISUSED, LOST, INTERRUPTED = 0, 1, 2, 3, 130
"""Exit codes; 3 is done, but with loss."""

_MISUSES = (UsageError, OptionError, RangeError, FormatError)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code.

    Args:
        argv: The arguments; None for those of the process.

    Raises:
        SystemExit: The arguments make no sense, or ask for help.
    """
    arguments = parser.build().parse_args(argv)
    try:
        with warnings.catch_warnings():
            # Each warning is shown once, also those that Python hides outside of `__main__`.
            warnings.simplefilter("default", UserWarning)
            warnings.showwarning = _show_warning
            code: int = arguments.run(arguments)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader of our output has closed it, as `head` does
        # Python flushes the standard output once more at exit, and would print an error about the broken pipe.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as error:
        if arguments.debug:
            raise
        _complain("error", error)
        return MISUSED if isinstance(error, _MISUSES) else FAILED


def _complain(what: str, error: object) -> None:
    print(f"{parser.NAME}: {what}: {_text(error)}", file=sys.stderr)


def _text(error: object) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error) or type(error).__name__


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    _complain("warning", message)
