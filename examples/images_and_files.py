"""Keep images and other files with a run, pair them with rows, list them and copy them out."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np

from ml_dash_mcap import Experiment, Recording

with Experiment("examples/camera/images-and-files", root=".dash").run as exp:
    frames = exp.files("frames", tags=["wrist"])
    for step in range(5):
        shades = np.linspace(0, 255, 64).astype(np.uint8) // (step + 1)
        image = np.broadcast_to(shades[:, None], (48, 64, 3))  # [height, width, 3], uint8
        name = f"frame_{step:05d}.png"
        frames.save_image(image, to=name)
        exp.tracks("camera").append(frame=f"frames/{name}", _ts=step / 30)

    exp.files.save_json({"fov_deg": 60, "size": [64, 48]}, to="configs/camera.json")
    print(f"camera.json says {json.loads(exp.files('configs/camera.json').read_text())}")

    for file in exp.files.list():
        print(f"{file['id']:<28}{file['contentType']:<18}tags {file['tags']}")
    with tempfile.TemporaryDirectory() as elsewhere:
        copies = frames.download("*_0000[0-2].png", to=elsewhere)  # checked against their SHA-256
        print(f"copied out: {sorted(Path(copy).name for copy in copies)}")

with Recording(exp.path) as recording:
    row = next(recording["camera"].rows(start=0.1))
    print(f"the frame at 0.1 s is there: {(exp.path / 'files' / row['frame']).is_file()}")
