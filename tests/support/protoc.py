"""The compiler of protobuf, which judges .proto files and makes classes of them."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import grpc_tools
from google.protobuf import descriptor_pb2

SHIPPED = Path(grpc_tools.__file__).parent / "_proto"

_PROGRAM = """
import base64, importlib, json, sys
sys.path.insert(0, sys.argv[1])
message_class = getattr(importlib.import_module(sys.argv[2]), sys.argv[3])
def plain(message):
    fields = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.has_presence and not message.HasField(field.name):
            continue
        if field.message_type is not None:
            value = [plain(each) for each in value] if field.is_repeated else plain(value)
        elif field.is_repeated:
            value = list(value)
        fields[field.name] = value
    return fields
for line in sys.stdin:
    message = message_class.FromString(base64.b64decode(line))
    print(json.dumps(plain(message), default=lambda data: {"base64": base64.b64encode(data).decode()}))
"""
"""Decodes messages, a line each, with a generated class. In a process of its own, because classes live for ever."""


def compile_files(files: Mapping[str, str], folder: Path) -> descriptor_pb2.FileDescriptorSet:
    """Compile files, by their names, into Python modules in a folder; returns the descriptors of all of them."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "grpc_tools.protoc", f"-I{folder}", f"-I{SHIPPED}", "--include_imports"]
    command += ["--include_source_info", f"--descriptor_set_out={folder / 'set'}", f"--python_out={folder}", *files]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return descriptor_pb2.FileDescriptorSet.FromString((folder / "set").read_bytes())


def decode(folder: Path, file: str, name: str, payloads: Sequence[bytes]) -> list[dict[str, Any]]:
    """Decode messages with the class that the compiler made of a file; absent fields are left out.

    Args:
        folder: Where the modules are.
        file: The file of the message, such as `ml_dash/Robot.proto`.
        name: The message, without its package.
        payloads: The messages.
    """
    import base64

    module = file.removesuffix(".proto").replace("/", ".") + "_pb2"
    lines = "\n".join(base64.b64encode(payload).decode() for payload in payloads)
    command = [sys.executable, "-c", _PROGRAM, str(folder), module, name]
    done = subprocess.run(command, input=lines, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def without_sources(files: descriptor_pb2.FileDescriptorSet) -> list[descriptor_pb2.FileDescriptorProto]:
    """Return the files as what counts: without comments, options that others define, and names that follow from others."""
    for file in files.file:
        file.ClearField("source_code_info")
        for message in file.message_type:
            _strip(message)
        for field in file.extension:
            field.ClearField("json_name")
    return sorted(files.file, key=lambda file: file.name)


def _strip(message: descriptor_pb2.DescriptorProto) -> None:
    for described in (message, *message.field):
        described.options.DiscardUnknownFields()
        if not described.options.ListFields():
            described.ClearField("options")
    for field in (*message.field, *message.extension):
        field.ClearField("json_name")
    for inner in message.nested_type:
        _strip(inner)
