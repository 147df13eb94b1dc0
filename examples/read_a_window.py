"""Read a part of a recording: a time range, some columns, as rows and as a Parquet file."""

from __future__ import annotations

import math
from pathlib import Path

import pyarrow.parquet as pq

from ml_dash_mcap import Experiment, Recording

with Experiment("examples/drone/window", root=".dash").run as exp:
    for step in range(6000):  # a minute at 100 Hz
        height_m = 1.0 + math.sin(step / 100)
        exp.tracks("drone").append(pose={"xyz": [0.0, 0.0, height_m], "yaw": 0.1}, battery=0.9, _ts=step / 100)

with Recording(exp.path) as recording:
    drone = recording["drone"]
    print(f"{drone.info.count} rows of {', '.join(drone.info.fields)}")

    window = drone.read(start=10.0, end=10.02, columns=["pose.yaw"])
    print(f"flat, with dotted names: {window['entries']}")

    row = next(drone.rows(start=10.0, columns=["pose"]))
    print(f"nested, as appended: {row}")

    file = Path(exp.path, "second-10.parquet")
    file.write_bytes(drone.read(start=10.0, end=11.0, columns=["pose"], format="parquet"))
    table = pq.read_table(file)
    print(f"{file.name}: {table.num_rows} rows of {', '.join(table.column_names)}")
