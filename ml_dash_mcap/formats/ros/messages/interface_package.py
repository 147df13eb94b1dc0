"""Writes an interface package, which ROS builds so that its own tools know our messages."""

from __future__ import annotations

from collections.abc import Iterable

from . import lossless_definitions
from .lossless import Message

_DEPENDENCIES = ("builtin_interfaces", "std_msgs")

_PACKAGE_XML = """\
<?xml version="1.0"?>
<?xml-model href="http://download.ros.org/schema/package_format3.xsd" schematypens="http://www.w3.org/2001/XMLSchema"?>
<package format="3">
  <name>{package}</name>
  <version>1.0.0</version>
  <description>Messages of a recording made with ml_dash_mcap</description>
  <maintainer email="nobody@example.com">nobody</maintainer>
  <license>MIT</license>

  <buildtool_depend condition="$ROS_VERSION == 2">ament_cmake</buildtool_depend>
  <buildtool_depend condition="$ROS_VERSION == 2">rosidl_default_generators</buildtool_depend>
  <buildtool_depend condition="$ROS_VERSION == 1">catkin</buildtool_depend>
  <build_depend condition="$ROS_VERSION == 1">message_generation</build_depend>
{depends}
  <exec_depend condition="$ROS_VERSION == 2">rosidl_default_runtime</exec_depend>
  <exec_depend condition="$ROS_VERSION == 1">message_runtime</exec_depend>
  <member_of_group condition="$ROS_VERSION == 2">rosidl_interface_packages</member_of_group>

  <export>
    <build_type condition="$ROS_VERSION == 2">ament_cmake</build_type>
    <build_type condition="$ROS_VERSION == 1">catkin</build_type>
  </export>
</package>
"""

_CMAKE = """\
cmake_minimum_required(VERSION 3.8)
project({package})

set(messages
{files}
)

if("$ENV{{ROS_VERSION}}" STREQUAL "1")
  find_package(catkin REQUIRED COMPONENTS message_generation std_msgs)
  list(TRANSFORM messages REPLACE "^msg/" "")
  add_message_files(DIRECTORY msg FILES ${{messages}})
  generate_messages(DEPENDENCIES std_msgs)
  catkin_package(CATKIN_DEPENDS message_runtime std_msgs)
else()
  find_package(ament_cmake REQUIRED)
  find_package(rosidl_default_generators REQUIRED)
{finds}
  rosidl_generate_interfaces(${{PROJECT_NAME}} ${{messages}} DEPENDENCIES {dependencies})
  ament_export_dependencies(rosidl_default_runtime)
  ament_package()
endif()
"""


def files(messages: Iterable[Message], package: str) -> dict[str, str]:
    """Return the files of a package with these messages and those in them, by their paths in it."""
    texts = {
        f"msg/{part.name}.msg": lossless_definitions.text(part, package)
        for message in messages
        for part in message.parts()
    }
    depends = "\n".join(
        f"  <depend{condition}>{name}</depend>"
        for name, condition in (("builtin_interfaces", ' condition="$ROS_VERSION == 2"'), ("std_msgs", ""))
    )
    return {
        "package.xml": _PACKAGE_XML.format(package=package, depends=depends),
        "CMakeLists.txt": _CMAKE.format(
            package=package,
            files="\n".join(f"  {path}" for path in texts),
            finds="\n".join(f"  find_package({name} REQUIRED)" for name in _DEPENDENCIES),
            dependencies=" ".join(_DEPENDENCIES),
        ),
        **texts,
    }
