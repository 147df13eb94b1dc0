"""Rerun, which judges recordings in protobuf: its check of MCAP files, and its tables of their messages."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

_PROGRAM = """
import base64, json, sys
import rerun
server = rerun.server.Server(host="127.0.0.1", datasets={"recording": [sys.argv[1]]})
client = server.client()  # each must live as long as the table is read
dataset = client.get_dataset("recording")
view = dataset.filter_contents(sys.argv[2] + "/**")
table = view.reader(index="message_log_time").to_arrow_table()
[column] = [name for name in table.column_names if name.endswith(":message")]
for time, messages in zip(table["message_log_time"].cast("int64").to_pylist(), table[column].to_pylist()):
    [message] = messages
    print(json.dumps([time, message], default=lambda data: {"base64": base64.b64encode(data).decode()}))
server.shutdown()
"""
"""Prints the messages of a topic, a line each. In a process of its own, because its server has threads."""


def is_here() -> bool:
    """Whether Rerun is installed; there are wheels from Python 3.11 on."""
    return find_spec("rerun") is not None and find_spec("datafusion") is not None


def check(path: Path, folder: Path) -> dict[str, str]:
    """Let `rerun mcap check` decode a whole file; returns its verdict on each topic, "ok" if there is nothing to say.

    Args:
        path: An MCAP file.
        folder: For Rerun's settings.
    """
    listed = _run(["mcap", "check", "--full", str(path)], folder).splitlines()
    rows = [line.split() for line in listed[[line.startswith("─") for line in listed].index(True) + 1 :]]
    return {row[3]: " ".join([row[0], *row[4:]]).removesuffix(" —") for row in rows if row}


def messages(path: Path, topic: str, folder: Path) -> list[tuple[int, dict[str, Any]]]:
    """Return the log time, in ns, and the message of each row of a topic's table, absent fields as None.

    Args:
        path: An MCAP file.
        topic: Of it.
        folder: For the file that Rerun makes of it.
    """
    converted = folder / f"{path.stem}.rrd"
    _run(["mcap", "convert", str(path), "-o", str(converted)], folder)
    printed = _python(["-c", _PROGRAM, str(converted), f"/{topic}"], folder)
    return [tuple(json.loads(line, object_hook=_with_bytes)) for line in printed.splitlines()]


def _with_bytes(value: dict[str, Any]) -> Any:
    return base64.b64decode(value["base64"]) if value.keys() == {"base64"} else value


def _run(arguments: Sequence[str], home: Path) -> str:
    return _python(["-m", "rerun", *arguments], home)


def _python(arguments: Sequence[str], home: Path) -> str:
    # Rerun sends no usage data before its second run in a home.
    environment = {**os.environ, "HOME": str(home), "XDG_CONFIG_HOME": str(home), "XDG_DATA_HOME": str(home)}
    done = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True, timeout=110)
    assert done.returncode == 0, done.stderr
    return done.stdout
