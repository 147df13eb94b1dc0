"""Reads an interface package with ROS's own rosidl; run with the system's Python.

    python3 check_package.py FOLDER PACKAGE

Prints a JSON object: each message with its fields, their types and units.
"""

import json
import pathlib
import sys
import tempfile

from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_parser.definition import IdlLocator, Message
from rosidl_parser.parser import parse_idl_file


def main() -> None:
    folder, package = pathlib.Path(sys.argv[1]), sys.argv[2]
    found = {}
    with tempfile.TemporaryDirectory() as out:
        for path in sorted(folder.glob("msg/*.msg")):
            idl = convert_msg_to_idl(folder, package, path.relative_to(folder), pathlib.Path(out) / "msg")
            read = parse_idl_file(IdlLocator(out, pathlib.Path("msg") / pathlib.Path(idl).name))
            (message,) = read.content.get_elements_of_type(Message)
            found[path.stem] = {member.name: units(member) for member in message.structure.members}
    print(json.dumps(found))


def units(member) -> list:
    return [value["value"] for value in member.get_annotation_values("unit")]


main()
