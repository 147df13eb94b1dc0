#!/usr/bin/env bash
# Checks a rosbag2 folder with ROS 2's own tools, where ROS 2 is installed.
#
#     tools/check_with_ros2.sh BAG
#
# `ros2 bag info` must read it, `ros2 bag convert` must copy it, and `ros2 bag play` must play it to its end. Messages of
# our own types are only played where their package, which lies in the bag's folder, was built and sourced.
set -euo pipefail

if [ $# -ne 1 ] || [ ! -d "$1" ]; then
    echo "usage: $0 BAG, the folder of a rosbag2" >&2
    exit 2
fi
if ! command -v ros2 >/dev/null 2>&1; then
    echo "skipped: there is no ros2 here; source /opt/ros/<distro>/setup.bash first" >&2
    exit 0
fi

bag=$(realpath "$1")
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

echo "== ros2 bag info"
ros2 bag info "$bag" | tee "$scratch/info"

echo "== ros2 bag convert"
cat >"$scratch/convert.yaml" <<YAML
output_bags:
  - uri: $scratch/copy
    storage_id: sqlite3
    all_topics: true
    all: true
YAML
ros2 bag convert --input "$bag" --output-options "$scratch/convert.yaml"
ros2 bag info "$scratch/copy" | tee "$scratch/copied"
if ! diff <(grep -E '^Messages:' "$scratch/info") <(grep -E '^Messages:' "$scratch/copied"); then
    echo "failed: the copy has another number of messages" >&2
    exit 1
fi

echo "== ros2 bag play"
timeout 600 ros2 bag play --rate 100 "$bag"
echo "done: ROS 2 reads, copies and plays $bag"
