"""Record a simulated Franka arm that lifts a kettle, controlled at 1 kHz, and show what the recording holds.

    pip install mujoco gymnasium-robotics matplotlib
    python examples/franka_control.py
    python examples/franka_control.py --seconds 60 --realtime

The scene is the `kitchen_franka` model inside gymnasium-robotics, loaded with mujoco alone. The arm moves above the
kettle, closes its gripper on the handle, lifts the kettle, puts it back and returns; a longer run repeats that.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
from matplotlib.figure import Figure  # without pyplot the plot is drawn by Agg, which needs no screen
from numpy.typing import NDArray

from ml_dash_mcap import Experiment, Recording

Array = NDArray[np.float64]

CONTROL_HZ = 1000
CONTACT_EVERY = 10  # ticks: 100 Hz
CAMERA_EVERY = 100  # ticks: 10 Hz
IMAGE_WIDTH, IMAGE_HEIGHT = 64, 48
INTERRUPTED_US = 100.0  # in a tick that takes so much longer than its own work something else ran
SWITCH_S = 0.0001  # how long the camera's Python may hold up the loop's at a time; Python's own default is 5 ms

ARM = slice(0, 7)  # joints of the arm in qpos, qvel and ctrl
FINGERS = slice(7, 9)
OPEN_M = 0.08
READY = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 0.0, 0.785])  # rad

# The gains of libfranka's examples/joint_impedance_control.cpp, in N m / rad and N m s / rad.
STIFFNESS = np.array([600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0])
DAMPING = np.array([50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0])

UP = np.array([0.0, 0.0, 1.0])
# Hand pointing down, fingers closing along world y, across the kettle's handle; columns are the hand's axes.
HAND_DOWN = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])


# The scene


def kitchen_path() -> Path:
    """Path of the kitchen model, found without importing gymnasium_robotics (which would load gymnasium)."""
    spec = importlib.util.find_spec("gymnasium_robotics")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("the kitchen model comes with gymnasium-robotics: pip install gymnasium-robotics")
    package = Path(spec.submodule_search_locations[0])
    return package / "envs/assets/kitchen_franka/kitchen_assets/kitchen_env_model.xml"


def load_kitchen() -> tuple[Any, Any]:
    """Load the kitchen with a torque-controlled arm in its ready pose and a simulation step of one control tick.

    The model comes with position servos and joints damped so strongly (100 N m s / rad) that the motors' limits allow
    less than 1 rad/s. The arm gets torque motors, and the armature and damping of MuJoCo Menagerie's Panda instead.
    The gripper keeps its servos.
    """
    model = mujoco.MjModel.from_xml_path(str(kitchen_path()))
    model.opt.timestep = 1.0 / CONTROL_HZ
    model.dof_damping[ARM] = 1.0
    model.dof_armature[ARM] = 0.1
    model.actuator_gainprm[ARM, 0] = 1.0
    model.actuator_biasprm[ARM] = 0.0
    model.actuator_ctrlrange[ARM] = model.actuator_forcerange[ARM]
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[ARM] = READY
    data.qpos[FINGERS] = OPEN_M / 2
    mujoco.mj_forward(model, data)
    return model, data


# The motion


@dataclass(frozen=True, slots=True)
class Phase:
    """One stretch of the motion, between two joint positions."""

    name: str
    start_s: float
    end_s: float
    q_from: Array
    """Joint angles at the start, [7], rad."""
    q_to: Array
    """Joint angles at the end, [7], rad."""
    opening_m: float
    """Distance wanted between the fingers."""


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What the controller should do now."""

    q: Array
    """Joint angles, [7], rad."""
    qd: Array
    """Joint velocities, [7], rad/s."""
    qdd: Array
    """Joint accelerations, [7], rad/s^2."""
    opening_m: float
    """Distance wanted between the fingers."""


def solve_ik(model: Any, data: Any, q_start: Array, position: Array) -> Array:
    """Joint angles that bring the gripper to a position with the hand pointing down (damped least squares)."""
    scratch = mujoco.MjData(model)
    scratch.qpos[:] = data.qpos
    scratch.qpos[ARM] = q_start
    low, high = model.jnt_range[ARM].T
    jacobian = np.zeros((6, model.nv))
    gripper = model.site("end_effector").id
    for _ in range(200):
        mujoco.mj_kinematics(model, scratch)
        mujoco.mj_comPos(model, scratch)
        axes = scratch.site_xmat[gripper].reshape(3, 3)
        turn = 0.5 * np.cross(axes, HAND_DOWN, axis=0).sum(axis=1)
        error = np.concatenate([position - scratch.site_xpos[gripper], turn])
        if np.abs(error).max() < 1e-5:
            return np.array(scratch.qpos[ARM])
        mujoco.mj_jacSite(model, scratch, jacobian[:3], jacobian[3:], gripper)
        arm = jacobian[:, ARM]
        step = arm.T @ np.linalg.solve(arm @ arm.T + 1e-3 * np.eye(6), error)
        step *= min(1.0, 0.2 / np.abs(step).max())
        scratch.qpos[ARM] = np.clip(scratch.qpos[ARM] + step, low, high)
    raise RuntimeError(f"no joint angles found for the gripper at {position} (still off by {error})")


def grasp_position(data: Any) -> Array:
    """Where the gripper takes the kettle, [3], m: a little above the middle of the handle, to keep the palm clear."""
    return np.asarray(data.site("kettle_site").xpos + 0.012 * UP)


def plan_motion(model: Any, data: Any) -> list[Phase]:
    """One cycle of eight seconds, as stretches between joint positions that start and end at rest."""
    grasp_m = grasp_position(data)
    above = solve_ik(model, data, READY, grasp_m + 0.10 * UP)
    grasp = solve_ik(model, data, above, grasp_m)
    lifted = solve_ik(model, data, grasp, grasp_m + 0.15 * UP)
    stretches = [
        ("ready", 0.3, READY, OPEN_M),
        ("reach", 1.8, above, OPEN_M),
        ("descend", 0.8, grasp, OPEN_M),
        ("grasp", 0.6, grasp, 0.0),
        ("lift", 1.0, lifted, 0.0),
        ("lower", 1.0, grasp, 0.0),
        ("release", 0.5, grasp, OPEN_M),
        ("retreat", 0.5, above, OPEN_M),
        ("return", 1.5, READY, OPEN_M),
    ]
    phases: list[Phase] = []
    q, start_s = READY, 0.0
    for name, duration_s, q_to, opening_m in stretches:
        end_s = round(start_s + duration_s, 3)  # whole ticks: 2.1 + 0.8 is not 2.9
        phases.append(Phase(name, start_s, end_s, q, q_to, opening_m))
        q, start_s = q_to, end_s
    return phases


def phase_at(phases: list[Phase], time_s: float) -> Phase:
    """The phase that holds a time of the cycle (start included, end not)."""
    return next((phase for phase in phases if time_s < phase.end_s), phases[-1])


def setpoint_at(phase: Phase, time_s: float) -> Setpoint:
    """The setpoint on the minimum-jerk curve of a phase (Flash and Hogan 1985)."""
    duration_s = phase.end_s - phase.start_s
    s = (time_s - phase.start_s) / duration_s
    way = phase.q_to - phase.q_from
    return Setpoint(
        q=phase.q_from + way * (10 * s**3 - 15 * s**4 + 6 * s**5),
        qd=way * (30 * s**2 - 60 * s**3 + 30 * s**4) / duration_s,
        qdd=way * (60 * s - 180 * s**2 + 120 * s**3) / duration_s**2,
        opening_m=phase.opening_m,
    )


# The robot


def joint_torque(model: Any, data: Any, target: Setpoint) -> Array:
    """Torque for the next millisecond, [7], N m: joint impedance around the arm's own dynamics.

    The arm knows its masses and friction but not the kettle's weight, which is the error that is left while it lifts.
    """
    inertia = np.zeros(model.nv)
    acceleration = np.zeros(model.nv)
    acceleration[ARM] = target.qdd
    mujoco.mj_mulM(model, data, inertia, acceleration)
    feed_forward = inertia[ARM] + data.qfrc_bias[ARM] + model.dof_damping[ARM] * target.qd
    feedback = STIFFNESS * (target.q - data.qpos[ARM]) + DAMPING * (target.qd - data.qvel[ARM])
    low, high = model.actuator_forcerange[ARM].T
    return np.asarray(np.clip(feed_forward + feedback, low, high))


def robot_state(data: Any, tau: Array, gripper: int) -> dict[str, Any]:
    """The robot as it is now: the fields of topic `robot`."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, data.site_xmat[gripper])  # w x y z
    return {
        "q": data.qpos[ARM],  # joint angles, [7], rad
        "qd": data.qvel[ARM],  # joint velocities, [7], rad/s
        "tau": tau,  # torques for the tick that begins now, [7], N m
        "ee_pos": data.site_xpos[gripper],  # between the fingers, [3], m, world frame
        "ee_quat": quaternion[[1, 2, 3, 0]],  # x y z w, as ROS and Foxglove have it
        "gripper_pos": float(data.qpos[FINGERS].sum()),  # distance between the fingers, m
    }


def finger_contacts(model: Any, data: Any) -> dict[str, Any]:
    """What the fingers touch now: the fields of topic `contact`."""
    fingers = {model.body("panda0_leftfinger").id, model.body("panda0_rightfinger").id}
    wrench = np.zeros(6)
    count, force_n = 0, 0.0
    touched: set[str] = set()
    for index, pair in enumerate(data.contact.geom[: data.ncon]):
        others = [geom for geom in pair if model.geom_bodyid[geom] not in fingers]
        if len(others) == 2:
            continue
        mujoco.mj_contactForce(model, data, index, wrench)
        count += 1
        force_n += float(wrench[0])
        touched.update(geom_name(model, geom) for geom in others)
    return {
        "count": count,  # contact points
        "normal_force": force_n,  # sum over the points, N
        "in_contact": count > 0,
        "geoms": sorted(touched),
    }


def geom_name(model: Any, geom: int) -> str:
    """Name of a geom; most in this kitchen have none and get their body's name and their number."""
    return model.geom(geom).name or f"{model.body(model.geom_bodyid[geom]).name}.{geom}"


# The camera


def camera_rays() -> Array:
    """Directions of a pinhole camera's rays, [pixels, 3], unit length, z forward (60 degrees from top to bottom)."""
    focal_px = 0.5 * IMAGE_HEIGHT / np.tan(np.radians(30.0))
    x, y = np.meshgrid(np.arange(IMAGE_WIDTH) - IMAGE_WIDTH / 2 + 0.5, np.arange(IMAGE_HEIGHT) - IMAGE_HEIGHT / 2 + 0.5)
    rays = np.stack([x, y, np.full_like(x, focal_px)], axis=-1).reshape(-1, 3)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def geom_colours(model: Any) -> Array:
    """Colour of every geom, [ngeom, 3], 0 to 1: its own, or its material's times the mean of the texture."""
    role = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
    colours = np.array(model.geom_rgba[:, :3], dtype=np.float64)
    for geom, material in enumerate(model.geom_matid):
        if material < 0:
            continue
        colours[geom] = model.mat_rgba[material, :3]
        texture = model.mat_texid[material, role]
        if texture >= 0:
            start, channels = model.tex_adr[texture], model.tex_nchannel[texture]
            pixels = model.tex_height[texture] * model.tex_width[texture]
            texels = model.tex_data[start : start + pixels * channels].reshape(pixels, channels)
            colours[geom] *= texels[:, :3].mean(axis=0) / 255.0
    return colours


class HandCamera:
    """A colour and depth camera on the hand, drawn with rays, so that it needs neither GPU nor screen.

    A picture takes some ten milliseconds: like a real camera's, it is taken beside the control loop, in one thread
    that appends to `obs` by itself. `take` is for the loop's thread and waits only for a picture that is overdue.
    """

    def __init__(self, exp: Experiment, model: Any) -> None:
        self._exp = exp
        self._model = model
        self._scene = mujoco.MjData(model)
        self._rays = camera_rays()
        self._colours = geom_colours(model)
        self._hand = model.body("panda0_link7").id
        self._gripper = model.site("end_effector").id
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="hand-camera")
        self._pending: Future[None] | None = None

    def close(self) -> None:
        """Wait for the last picture."""
        self._thread.shutdown(wait=True)
        if self._pending is not None:
            self._pending.result()

    def take(self, step: int, data: Any) -> None:
        """Take a picture of the scene as it is now."""
        if self._pending is not None:
            self._pending.result()
        mujoco.mj_copyData(self._scene, self._model, data)
        self._pending = self._thread.submit(self._record, step)

    def _record(self, step: int) -> None:
        rgb, depth = self._picture()
        name = f"{step:06d}.png"
        self._exp.files("rgb").save_image(rgb, to=name)
        self._exp.files("depth").save_image(depth, to=name)
        self._exp.tracks("obs").append(rgb_path=f"rgb/{name}", depth_path=f"depth/{name}", _ts=step / CONTROL_HZ)

    def _picture(self) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        """Colours, [height, width, 3], and depth along the optical axis, [height, width], mm, 0 for nothing."""
        model, scene = self._model, self._scene
        axes = scene.site_xmat[self._gripper].reshape(3, 3)
        eye = scene.site_xpos[self._gripper] + axes @ [0.06, 0.0, -0.17]
        rays = self._rays @ axes.T
        geoms = np.zeros(len(rays), dtype=np.int32)
        dist = np.zeros(len(rays))  # m
        normals = np.zeros(rays.size)
        seen = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)  # geom groups that are looks; the others only collide
        hand, count = self._hand, len(rays)  # the hand itself is left out, the fingers are not
        mujoco.mj_multiRay(model, scene, eye, rays.ravel(), seen, True, hand, geoms, dist, normals, count, 5.0)
        facing = np.abs(np.einsum("ij,ij->i", normals.reshape(-1, 3), rays))
        rgb = self._colours[geoms] * (0.25 + 0.75 * facing[:, None]) * (geoms >= 0)[:, None]
        depth_mm = np.maximum(dist, 0.0) * self._rays[:, 2] * 1000.0
        size = (IMAGE_HEIGHT, IMAGE_WIDTH)
        return (rgb * 255).astype(np.uint8).reshape(*size, 3), depth_mm.astype(np.uint16).reshape(size)


# The control loop


@dataclass(frozen=True, slots=True)
class Timing:
    """What a run of the loop cost."""

    append_us: Array
    """Time inside `append` in each tick, [ticks], us: the loop's own, by its thread's clock."""
    elapsed_us: Array
    """The same by the wall clock, [ticks], us: with what other threads and programs took meanwhile."""
    late_us: Array
    """How long after its time each tick began, [ticks], us; zeros unless the loop was paced."""
    wall_s: float
    """How long the loop took."""


def control_loop(exp: Experiment, model: Any, data: Any, phases: list[Phase], *, steps: int, realtime: bool) -> Timing:
    """Run the arm for a number of ticks, and log each."""
    gripper = model.site("end_effector").id
    grasp_m = grasp_position(data)
    cycle_steps = round(phases[-1].end_s * CONTROL_HZ)
    append_ns = np.zeros(steps)
    elapsed_ns = np.zeros(steps)
    late_ns = np.zeros(steps)
    touching = False
    last_name = ""

    with closing(HandCamera(exp, model)) as camera:
        began_ns = time.perf_counter_ns()
        for step in range(steps):
            ts = step / CONTROL_HZ
            if realtime:
                late_ns[step] = wait_until(began_ns + step * 1_000_000_000 // CONTROL_HZ)

            mujoco.mj_step1(model, data)  # positions, velocities and contacts as they are at ts
            cycle_s = step % cycle_steps / CONTROL_HZ
            phase = phase_at(phases, cycle_s)
            target = setpoint_at(phase, cycle_s)
            tau = joint_torque(model, data, target)
            data.ctrl[ARM] = tau
            data.ctrl[FINGERS] = target.opening_m / 2
            state = robot_state(data, tau, gripper)

            began, own_began = time.perf_counter_ns(), time.thread_time_ns()
            exp.tracks("robot").append(**state, _ts=ts)
            exp.tracks("action").append(target_q=target.q, target_gripper=target.opening_m, _ts=ts)
            append_ns[step] = time.thread_time_ns() - own_began
            elapsed_ns[step] = time.perf_counter_ns() - began

            if phase.name != last_name:
                exp.log(f"phase {phase.name}", sim_time_s=ts)
                last_name = phase.name
            if step % CAMERA_EVERY == 0:
                camera.take(step, data)
                distance_m = float(np.linalg.norm(state["ee_pos"] - grasp_m))
                exp.metrics("reach").log(error=distance_m, step=step)

            mujoco.mj_step2(model, data)  # solves the contact forces at ts, then moves on to the next tick
            if step % CONTACT_EVERY == 0:
                contact = finger_contacts(model, data)
                if contact["in_contact"] or touching:  # one more row when the fingers let go
                    began, own_began = time.perf_counter_ns(), time.thread_time_ns()
                    exp.tracks("contact").append(**contact, _ts=ts)
                    append_ns[step] += time.thread_time_ns() - own_began
                    elapsed_ns[step] += time.perf_counter_ns() - began
                touching = contact["in_contact"]
        wall_s = (time.perf_counter_ns() - began_ns) / 1e9
    return Timing(append_us=append_ns / 1e3, elapsed_us=elapsed_ns / 1e3, late_us=late_ns / 1e3, wall_s=wall_s)


def warm_up(model: Any, data: Any, phases: list[Phase]) -> None:
    """Run the loop for a second and forget it: imports and first calls take milliseconds, which a robot at rest has."""
    rehearsal = mujoco.MjData(model)
    mujoco.mj_copyData(rehearsal, model, data)
    with TemporaryDirectory() as scratch, Experiment(prefix="warm/up", root=scratch).run as exp:
        control_loop(exp, model, rehearsal, phases, steps=CONTROL_HZ, realtime=False)


def wait_until(deadline_ns: int) -> int:
    """Sleep until a time of `perf_counter_ns`, and say by how much it was missed (ns)."""
    remaining_ns = deadline_ns - time.perf_counter_ns()
    if remaining_ns > 0:
        time.sleep(remaining_ns / 1e9)
    return time.perf_counter_ns() - deadline_ns


# What was recorded


def column(entries: list[dict[str, Any]], name: str) -> Array:
    """One field of all rows as an array."""
    return np.array([entry[name] for entry in entries], dtype=np.float64)


def print_window(exp: Experiment, start_s: float, end_s: float) -> None:
    """Read a window of `robot` back (both ends included) and print its first and last row."""
    began = time.perf_counter()
    window = exp.tracks("robot").read(start_timestamp=start_s, end_timestamp=end_s, columns=["q", "ee_pos"])
    took_ms = (time.perf_counter() - began) * 1e3
    print(f"\nRead q and ee_pos of robot from {start_s:g} s to {end_s:g} s: {window['count']} rows in {took_ms:.1f} ms")
    for entry in window["entries"][:: max(1, window["count"] - 1)]:
        q, ee_pos = np.round(entry["q"], 3).tolist(), np.round(entry["ee_pos"], 3).tolist()
        print(f"  {entry['timestamp']:.3f} s  q {q}  ee_pos {ee_pos}")


def print_tracking(robot: list[dict[str, Any]], action: list[dict[str, Any]]) -> None:
    """Print how well the arm followed its targets, from the rows read back."""
    error_mrad = np.abs(column(robot, "q") - column(action, "target_q")) * 1e3
    per_joint = "  ".join(f"{value:.1f}" for value in error_mrad.max(axis=0))
    print(f"\nTracking error: {np.sqrt((error_mrad**2).mean()):.2f} mrad rms; max per joint {per_joint} mrad")


def print_timing(timing: Timing, *, realtime: bool) -> None:
    """Print what logging cost the loop, and how well a paced loop kept its time."""
    ticks = len(timing.append_us)
    p50, p999 = np.percentile(timing.append_us, [50, 99.9])
    held_up = timing.elapsed_us[timing.elapsed_us - timing.append_us > INTERRUPTED_US]
    print(f"\nThe loop: {ticks} ticks in {timing.wall_s:.2f} s ({timing.wall_s / ticks * 1e6:.0f} us a tick)")
    print(f"  inside append, a tick: median {p50:.1f} us, p99.9 {p999:.1f} us, max {timing.append_us.max():.1f} us")
    print("  (the loop's own time, for two or three rows a tick; a second of warming up is not in it)")
    if len(held_up):
        usual_ms, most_ms = np.median(held_up) / 1e3, held_up.max() / 1e3
        print(f"  in {len(held_up)} ticks the camera's thread or another program had the processor meanwhile:")
        print(f"  {usual_ms:.1f} ms as a rule, {most_ms:.1f} ms at most, as between any two lines of the loop")
    if realtime:
        late, median_us = int((timing.late_us > 1000.0).sum()), np.median(timing.late_us)
        print(f"  paced at {CONTROL_HZ} Hz: median {median_us:.0f} us late, {late} ticks late by over 1 ms")


def print_recording(folder: Path) -> None:
    """Open the finished recording and print its topics and its files."""
    print(f"\n{'topic':<10}{'rows':>8}{'rate':>12}{'duration':>12}   fields")
    with Recording(folder) as recording:
        for name, topic in sorted(recording.topics.items()):
            duration_s = topic.end - topic.start
            print(f"{name:<10}{topic.count:>8}{topic.rate:>9.1f} Hz{duration_s:>10.3f} s   {', '.join(topic.fields)}")
    print(f"\nIn {folder}:")
    for path in sorted(path for path in folder.rglob("*") if path.is_file() and path.suffix != ".png"):
        print(f"  {path.relative_to(folder)!s:<40}{path.stat().st_size / 1e3:>10.1f} kB")
    images = list(folder.rglob("[0-9]*.png"))
    print(f"  {f'{len(images)} images':<40}{sum(path.stat().st_size for path in images) / 1e3:>10.1f} kB")


def print_how_to_open(folder: Path) -> None:
    """Print what to open the recording with."""
    newest = sorted(folder.glob("*.mcap"))[-1]
    print(f"\nTo look at this run, drag {newest} into Foxglove (app.foxglove.dev) or Lichtblick,")
    print("and add a Plot panel with these paths:")
    print("  robot.q[0]            action.target_q[0]      a joint and its target")
    print("  robot.gripper_pos     contact.normal_force    the grasp")


# The plot


JOINT_COLOURS = ["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#6A4C93"]


def shade_phases(axes: Any, phases: list[Phase], seconds: float) -> None:
    """Shade every other phase in all axes, and name the phases above the first, if there is room."""
    cycle_s = phases[-1].end_s
    for cycle in range(int(np.ceil(seconds / cycle_s))):
        for index, phase in enumerate(phases):
            start_s = phase.start_s + cycle * cycle_s
            end_s = min(phase.end_s + cycle * cycle_s, seconds)
            if start_s >= end_s:
                return
            for axis in axes:
                axis.axvspan(start_s, end_s, color="#9aa7b4" if index % 2 else "#ffffff", alpha=0.18, linewidth=0)
            if seconds <= cycle_s:
                above = axes[0].get_xaxis_transform()
                axes[0].text((start_s + end_s) / 2, 1.02, phase.name, transform=above, ha="center", color="#444")


def draw_plot(exp: Experiment, phases: list[Phase], path: Path) -> None:
    """Draw joints, tracking error, gripper position and grasp from the rows read back."""
    robot = exp.tracks("robot").read()["entries"]
    action = exp.tracks("action").read()["entries"]
    contact = exp.tracks("contact").read()["entries"]
    print_tracking(robot, action)
    t = column(robot, "timestamp")
    q, target_q = column(robot, "q"), column(action, "target_q")
    ee_pos = column(robot, "ee_pos")

    figure = Figure(figsize=(12, 12), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[3, 1.5, 1.5, 1.5])
    dashed: dict[str, Any] = {"color": "black", "linewidth": 0.9, "dashes": (4, 4)}
    for joint, colour in enumerate(JOINT_COLOURS):
        axes[0].plot(t, q[:, joint], color=colour, linewidth=1.8, label=f"q[{joint}]")
        axes[0].plot(t, target_q[:, joint], **dashed, label="target" if joint == 6 else None)
        axes[1].plot(t, (q - target_q)[:, joint] * 1e3, color=colour, linewidth=1.2)
    axes[0].set_ylabel("joint angle [rad]")
    axes[1].set_ylabel("q - target [mrad]")
    for index, (name, colour) in enumerate(zip("xyz", JOINT_COLOURS, strict=False)):
        axes[2].plot(t, ee_pos[:, index], color=colour, linewidth=1.8, label=f"ee {name}")
    axes[2].set_ylabel("gripper position [m]")
    axes[3].plot(t, column(robot, "gripper_pos") * 1e3, color=JOINT_COLOURS[0], linewidth=1.8, label="opening")
    axes[3].plot(t, column(action, "target_gripper") * 1e3, **dashed, label="target")
    axes[3].set_ylim(-3.0, 87.0)
    axes[3].set_ylabel("gripper opening [mm]")
    axes[3].set_xlabel("simulated time [s]")
    if contact:
        force = axes[3].twinx()
        touch_t, touch_n = column(contact, "timestamp"), column(contact, "normal_force")
        gaps = np.flatnonzero(np.diff(touch_t) > 1.5 * CONTACT_EVERY / CONTROL_HZ) + 1  # no rows without a touch
        force.plot(np.insert(touch_t, gaps, np.nan), np.insert(touch_n, gaps, np.nan), color=JOINT_COLOURS[5])
        force.set_ylabel("force on the fingers [N]", color=JOINT_COLOURS[5])
        force.set_ylim(bottom=0.0)
    for axis in (axes[0], axes[2], axes[3]):
        axis.legend(loc="center left", bbox_to_anchor=(1.06, 0.5), frameon=False)
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.margins(x=0)
    shade_phases(axes, phases, float(t[-1]))
    figure.suptitle("Franka arm lifting a kettle, controlled and recorded at 1 kHz")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


# The command


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Record a simulated Franka arm at 1 kHz.")
    parser.add_argument("--root", type=Path, default=Path(".dash"), help="folder of all recordings (default: .dash)")
    parser.add_argument("--prefix", default="demo/franka/reach-and-grasp", help="name of the run, owner/project/...")
    parser.add_argument("--seconds", type=float, default=8.0, help="simulated time (default: 8, one cycle)")
    parser.add_argument("--realtime", action="store_true", help="pace the loop to the wall clock")
    parser.add_argument("--plot", type=Path, help="where the plot goes (default: plot.png beside the recording)")
    arguments = parser.parse_args()
    if arguments.seconds < 1 / CONTROL_HZ:
        parser.error(f"--seconds {arguments.seconds:g} is less than one tick of {1 / CONTROL_HZ:g} s")
    return arguments


def main() -> None:
    """Record, then show."""
    arguments = parse_arguments()
    model, data = load_kitchen()
    phases = plan_motion(model, data)
    steps = round(arguments.seconds * CONTROL_HZ)
    folder = arguments.root / arguments.prefix
    plot = arguments.plot or folder / "plot.png"

    sys.setswitchinterval(SWITCH_S)
    warm_up(model, data, phases)
    with Experiment(prefix=arguments.prefix, root=arguments.root).run as exp:
        exp.params.set(
            robot="franka_panda",
            task="reach, grasp and lift the kettle",
            control_freq=CONTROL_HZ,
            camera_freq=CONTROL_HZ // CAMERA_EVERY,
            stiffness=STIFFNESS.tolist(),
            damping=DAMPING.tolist(),
            simulator=f"mujoco {mujoco.__version__}",
        )
        timing = control_loop(exp, model, data, phases, steps=steps, realtime=arguments.realtime)
        print_timing(timing, realtime=arguments.realtime)
        draw_plot(exp, phases, plot)
        print_window(exp, start_s=0.0, end_s=min(5.0, arguments.seconds))
    print_recording(folder)
    print(f"\nPlot: {plot}")
    print_how_to_open(folder)


if __name__ == "__main__":
    main()
