"""Record a session in dreamlake's words: automatic and inherited time stamps, points by index and by time."""

from __future__ import annotations

from ml_dash_mcap import Session

with Session(name="quickstart", workspace="examples", local_path=".dreamlake") as session:
    session.parameters().set(learning_rate=0.001)
    session.log("recording starts")

    pose, camera = session.track("robot/pose"), session.track("camera/left")
    for step in range(100):
        pose.append(position=[0.01 * step, 0.0, 0.3], step=step)  # the time is now
        camera.append(frame_id=step, _ts=-1)  # the time of the pose

    page = pose.read(start_index=0, limit=3)
    print(f"the first {page['total']} points have the steps {[point['data']['step'] for point in page['data']]}")

    times = [[point["data"]["_ts"] for point in track.read()["data"]] for track in (pose, camera)]
    print(f"pose and camera have the same times: {times[0] == times[1]}")
    print(f"tracks: {session.tracks.list()}, points of the pose: {pose.stats()['totalDataPoints']}")
