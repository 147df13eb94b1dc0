"""Record the log of a simulator, which is there as whole arrays, and read a part of it."""

from __future__ import annotations

import numpy as np

from ml_dash_mcap import Recorder, RecorderOptions, Recording

FOLDER = ".dash/examples/recorder-columns"
STEPS = 20_000
times_s = np.arange(STEPS) / 1000.0
angles = np.sin(times_s[:, None] * np.arange(1, 8))  # [steps, 7], rad
touching = angles[:, 0] > 0.5

with Recorder(FOLDER, RecorderOptions(compression="zstd")) as recorder:
    recorder.set_parameters({"simulator": "sines", "timestep_s": 0.001})
    sim = recorder.topic("sim", description="a simulated arm")
    sim.append_columns(_ts=times_s, q=angles, touching=touching)  # one row a step
    sim.flush()
    figures = recorder.stats()
    print(f"{figures['written']} rows written, {figures['dropped']} dropped")

with Recording(FOLDER) as recording:
    info = recording.topics["sim"]
    print(f"sim: {info.count} rows, {info.rate:.0f} Hz, {info.start} s to {info.end} s, {dict(info.fields)}")
    row = next(recording["sim"].rows(start=10.0))
    print(f"as recorded, bit for bit: {row['q'] == angles[10_000].tolist()}")
