"""ROS's own tools take the package that we write for our messages."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

from ml_dash_mcap.formats.ros.messages import interface_package
from ml_dash_mcap.formats.ros.messages.lossless import Message
from tests.formats.ros.test_lossless import PACKAGE, designed, timed
from tests.support import system_python


def with_rosidl(folder: Path) -> dict[str, dict[str, list[str]]]:
    found: dict[str, dict[str, list[str]]] = system_python.run(
        "check_package.py", folder, PACKAGE, needs=("rosidl_adapter", "rosidl_parser"), package="python3-rosidl"
    )
    return found


def write(folder: Path, *messages: Message) -> Path:
    for name, text in interface_package.files(messages, PACKAGE).items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def test_ros_parses_the_messages_and_finds_their_units(tmp_path: Path) -> None:
    rows: list[dict[str, Any]] = [
        {
            "q": [0.5] * 7,
            "eeQuat": [0.0, 0.0, 0.0, 1.0],
            "class": "a",
            "T": [[0.5] * 4] * 4,
            "mixed": 1,
            "ints": [1, 0.5],
            "nested": {"deep": {"x [m]": 1.0}, "text": 'say "hi" \\ *'},
            "contacts": [{"body": "a", "force": [1.0, 2.0, 3.0]}],
            "image": b"\0",
            "note": None,
        },
        {"mixed": 0.5, "contacts": []},
    ]
    robot = designed(timed(rows))
    about = {"topic": 'a "b" [c]', "metadata": {"units": {"q": "rad", "T": "m"}, "joint_names": ["a", "b"]}}
    robot = Message(robot.name, robot.fields, robot.is_stated, about=about)
    empty = Message("Empty", (), False, about={"topic": "empty"})
    found = with_rosidl(write(tmp_path, robot, empty))
    assert sorted(found) == ["Empty", "RobotArm", "RobotArmContacts", "RobotArmNested", "RobotArmNestedDeep"]
    assert list(found["Empty"]) == ["header", "ts"]
    assert list(found["RobotArm"]) == [
        *("header", "ts", "field_state", "q", "ee_quat", "f_class", "t", "mixed", "ints", "ints_integers"),
        *("nested", "contacts", "image", "note"),
    ]
    units = {name: unit for fields in found.values() for name, unit in fields.items() if unit}
    assert units == {"q": ["rad"], "t": ["m"]}


def test_the_package_is_described_for_both_generations_of_ros(tmp_path: Path) -> None:
    files = interface_package.files([designed(timed([{"a": {"b": 1}}]))], PACKAGE)
    assert sorted(files) == ["CMakeLists.txt", "msg/RobotArm.msg", "msg/RobotArmA.msg", "package.xml"]
    root = ElementTree.fromstring(files["package.xml"])
    assert root.findtext("name") == PACKAGE
    assert [one.text for one in root.findall("depend")] == ["builtin_interfaces", "std_msgs"]
    assert "msg/RobotArm.msg" in files["CMakeLists.txt"]
    assert "${messages}" in files["CMakeLists.txt"]
