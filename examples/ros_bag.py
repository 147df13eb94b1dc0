"""Record an arm, turn the recording into ROS bags and back, and say what ROS sees."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

from ml_dash_mcap import Experiment, Recording, convert

with Experiment("examples/arm/ros-bag", root=".dash").run as exp:
    robot = exp.tracks(
        "robot",
        units={"q": "rad", "ee_pos": "m"},
        joint_names=[f"panda_joint{number}" for number in range(1, 8)],
        frame_id="panda_link0",
        quat_order="xyzw",
    )
    for step in range(1000):
        t = 1_700_000_000.0 + step / 100
        half = 0.1 * math.sin(step / 100)
        robot.append(
            q=[0.1 * joint + half for joint in range(7)],
            ee_pos=[0.5, 0.0, 0.3 + half],
            ee_quat=[0.0, 0.0, math.sin(half), math.cos(half)],
            phase="reach" if step < 500 else "grasp",
            _ts=t,
        )

folder = Path(exp.path).parent / "bags"
shutil.rmtree(folder, ignore_errors=True)  # an export does not overwrite
with Recording(exp.path) as recording:
    bag = recording.export(folder / "arm", format="rosbag2", distro="humble")
    recording.export(folder / "arm.bag", format="rosbag1", compression="lz4")
    before = list(recording["robot"].rows())

print("what ROS 2 sees, as `ros2 bag info` would list it:")
for line in (bag / "metadata.yaml").read_text().splitlines():
    if line.strip().startswith(("- path:", "name:", "type:", "message_count:")):
        print("  ", line.strip())
print("the message that says all:", *sorted(path.name for path in bag.glob("ml_dash_msgs/msg/*")))

for source in (bag, folder / "arm.bag"):
    back = convert(source, folder / f"back-from-{source.name}")
    with Recording(back) as recording:
        print(f"{source.name} gives back every row as it was: {list(recording['robot'].rows()) == before}")
