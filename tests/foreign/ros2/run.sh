#!/bin/bash
# Tries consort-ros2 against genuine ROS 2: rclpy on rmw_zenoh. Prints `pass NAME`, `fail NAME: why` or `skip NAME: why`
# for each case; ends with 1 if a case failed. Arguments select cases by name. Settings, all optional:
#   ROS2_KIT      folder with make-venv.sh, env.sh and overlay.tar.xz (default: foreign/ros2 beside the repository's folder)
#   ROS2_VENV     virtual environment; made if missing (default: target/foreign/ros2/venv)
#   CONSORT, CONSORT_ROS2   the programs (default: those of target/debug and sim_bridge/ros2/target/debug)
set -uo pipefail
here=$(cd "$(dirname "$0")" && pwd); root=$(cd "$here/../../.." && pwd)
kit=${ROS2_KIT:-$root/../shared/foreign/ros2}
export V=${ROS2_VENV:-$root/target/foreign/ros2/venv}
export CONSORT=${CONSORT:-$root/target/debug/consort} CONSORT_ROS2=${CONSORT_ROS2:-$root/sim_bridge/ros2/target/debug/consort-ros2}
skip_all() { for name in $(python3 "$here/cases.py" --list); do echo "skip ros2_$name: $1"; done; exit 0; }
[ -f "$kit/make-venv.sh" ] || skip_all "the kit with ROS 2 is absent (ROS2_KIT=$kit)"
command -v python3.11 >/dev/null || skip_all "python3.11 is absent, for which the wheels of ROS 2 are built"
command -v gcc >/dev/null && command -v g++ >/dev/null || skip_all "gcc and g++ are absent, which compile further messages"
[ -x "$CONSORT_ROS2" ] || skip_all "consort-ros2 is not built (cargo build --manifest-path sim_bridge/ros2/Cargo.toml)"
[ -x "$CONSORT" ] || skip_all "consort is not built (cargo build)"
work=$(dirname "$V"); mkdir -p "$work"
export KILTED=$work/kilted
# Packages that are no wheels; the last one has its definitions here. The mark changes with what is installed.
packages="nav2_msgs tf2_msgs rmf_door_msgs rmf_lift_msgs consort_test_msgs"
mark=$V/.consort-messages-$(cat "$here/run.sh" "$here/make_messages.py" "$root/sim_bridge/ros2/types/jazzy.txt" | sha256sum | cut -c 1-16)
if [ ! -e "$mark" ]; then
    {
        [ -x "$V/bin/python" ] || "$kit/make-venv.sh" "$V"
        "$V/bin/pip" install -q ros-jazzy-sensor-msgs==5.3.6 ros-jazzy-nav-msgs==5.3.6 ros-jazzy-diagnostic-msgs==5.3.6 catkin_pkg
        # The messages of Kilted, for their hashes.
        [ -x "$KILTED/bin/python" ] || python3.11 -m venv "$KILTED"
        "$KILTED/bin/pip" install -q ros-kilted-rclpy==9.1.2 ros-kilted-{std-srvs,sensor-msgs,nav-msgs,diagnostic-msgs}==5.5.1
        . "$kit/env.sh"
        rm -rf "$work/messages"; cp -r "$here/messages" "$work/messages"
        python3 "$here/definitions.py" "$root/sim_bridge/ros2/types/jazzy.txt" "$work/messages" $packages
        "$V/bin/python" "$here/make_messages.py" "$V" "$work/messages" $packages && touch "$mark"
    } > "$work/make.log" 2>&1 || true
    [ -e "$mark" ] || { echo "fail ros2_environment: it cannot be made ($work/make.log)"; exit 1; }
fi
. "$kit/env.sh"
export ROS_PRELOAD
exec python3 "$here/cases.py" "$@"
