"""Rows of one topic and one time stamp are one row; later fields win, whenever they come."""

from __future__ import annotations

from ml_dash_mcap import Experiment

with Experiment("examples/camera/same-time-rows", root=".dash").run as exp:
    rgb = exp.tracks("camera/rgb")

    # A sample in two parts: the frame's number at once, its file when it is on disk.
    rgb.append(frame_id=0, exposure_s=0.01, _ts=0.0)
    rgb.append(path="frame_0.png", _ts=0.0)
    print(f"two appends, one row: {rgb.read()['entries']}")  # reading writes what waits first

    # The same from further away: other rows lie between, and the first part is in the file already.
    rgb.append(frame_id=1, exposure_s=0.01, _ts=1 / 30)
    rgb.append(exposure_s=0.02, _ts=0.0)
    print(f"a later field wins: {rgb.slice().findByTime(0.0)}")

    # The same double counts, not the same nanosecond or a rounded text.
    rgb.append(frame_id=2, _ts=0.1 + 0.2)
    rgb.append(frame_id=3, _ts=0.3)
    print(f"rows from 0.25 s on: {[entry['timestamp'] for entry in rgb.read(start_timestamp=0.25)['entries']]}")

    # Other topics keep rows of their own at the same time, to be aligned by it.
    exp.tracks("robot").append(q=[0.1, 0.2], _ts=1 / 30)
    at = exp.tracks("robot").list_entries()[-1]["timestamp"]
    print(f"the frame at the robot's time: {rgb.slice().findByTime(at)['frame_id']}")
