"""Record a run in ml-dash's words, and read a window of it back."""

from __future__ import annotations

from ml_dash_mcap import Experiment

with Experiment(prefix="examples/franka/quickstart", root=".dash").run as exp:
    exp.params.set(robot="franka_panda", control_freq=1000)
    exp.log("recording starts")

    robot = exp.tracks("robot")
    for step in range(1000):
        robot.append(q=[0.001 * step] * 7, gripper=0.04, _ts=step * 0.001)

    window = robot.read(start_timestamp=0.5, end_timestamp=0.6, columns=["gripper"])  # both ends included
    print(f"{window['count']} rows from 0.5 s to 0.6 s, the first one: {window['entries'][0]}")
    print(f"last row at or before 0.1234 s: {robot.slice().findByTime(0.1234)['timestamp']} s")

for segment in sorted(exp.path.glob("*.mcap")):
    print(f"recorded into {segment.parent.name}/, {segment.stat().st_size // 1000} kB")
