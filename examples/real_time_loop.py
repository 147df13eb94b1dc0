"""A 1 kHz control loop that would rather lose a row than wait, and what logging costs it."""

from __future__ import annotations

import time

from ml_dash_mcap import Recorder, RecorderOptions

TICKS = 1000
PERIOD_NS = 1_000_000

# If the disk stands still until the backlog is full, append refuses rows and counts them; it never waits.
options = RecorderOptions(on_full="drop", backlog_bytes=8 * 1024 * 1024)

with Recorder(".dash/examples/real-time-loop", options) as recorder:
    arm, imu = recorder.topic("arm"), recorder.topic("imu")  # opened before the loop, not in it
    append_ns = []
    began_ns = time.perf_counter_ns()
    for tick in range(TICKS):
        time.sleep(max(0, began_ns + tick * PERIOD_NS - time.perf_counter_ns()) / 1e9)
        now_s = tick * PERIOD_NS / 1e9

        before_ns = time.perf_counter_ns()
        arm.append(q=[0.1] * 7, qd=[0.0] * 7, tau=[1.5] * 7, _ts=now_s)
        imu.append(accel=[0.0, 0.0, 9.81], gyro=[0.0] * 3, _ts=now_s)
        append_ns.append(time.perf_counter_ns() - before_ns)

    append_ns.sort()
    median_us, p99_us = append_ns[TICKS // 2] / 1e3, append_ns[TICKS * 99 // 100] / 1e3
    print(f"logging two rows took {median_us:.0f} us in the median tick, {p99_us:.0f} us at the 99th percentile")

    recorder.flush()
    stats = recorder.stats()
    print(f"accepted {stats['accepted']} = written {stats['written']} + waiting {stats['waiting']}", end=" ")
    print(f"+ dropped {stats['dropped']}")
