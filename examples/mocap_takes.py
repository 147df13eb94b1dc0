"""Record a robot's hand and a marker on it, export a take for motion capture tools, read it back, plot the path."""

from __future__ import annotations

import math

import matplotlib as mpl
import numpy as np

from ml_dash_mcap import Experiment, Recording, convert

mpl.use("Agg")
from matplotlib import pyplot as plt

RATE_HZ = 120

with Experiment("examples/mocap/takes", root=".dash").run as exp:
    robot = exp.tracks("robot", quat_order="wxyz", joint_names=["shoulder", "elbow"])
    for frame in range(2 * RATE_HZ):
        time, turn = frame / RATE_HZ, math.pi * frame / RATE_HZ
        position = [math.cos(turn), math.sin(turn), 0.1 * turn]
        rotation = [math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2)]
        robot.append(ee_pos=position, ee_quat=rotation, q=[turn, 0.1 * turn], _ts=time)
        if not 100 <= frame < 140:  # the camera does not see it from behind
            tip = [1.2 * position[0], 1.2 * position[1], position[2]]
            exp.tracks("hand").append(markers={"tip": tip}, _ts=time)

with Recording(exp.path) as recording:
    take = recording.export("take.csv", format="mocap")  # OptiTrack Motive; the joints go to take.joints.sto
    markers = recording.export("take.trc", format="trc", up="y", length_units="mm")  # OpenSim
    print(f"{take.name}: {take.read_text().count(',Rigid Body')} columns of a rigid body")
    print(f"{markers.name}: {markers.read_text().splitlines()[3].split()[2:]}")

folder = convert("take.csv", "take")
with Recording(folder) as again, Recording(exp.path) as recording:
    same = list(again["robot"].rows()) == list(recording["robot"].rows())
    print(f"back again: {', '.join(again.topics)}; the same rows: {same}")
    path, seen = again["robot"].to_numpy()["ee_pos"], again["hand"].to_numpy()["markers.tip"]

figure, axes = plt.subplots()
axes.plot(path[:, 0], path[:, 1], label="robot")
axes.scatter(seen[:, 0], seen[:, 1], s=np.full(len(seen), 4), color="tab:orange", label="hand:tip")
axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
axes.legend()
figure.savefig("take.png")
print("take.png has the path")
