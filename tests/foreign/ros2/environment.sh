# Sourced by a run.sh that defines `skip_all WHY`, which ends the script: makes the environment with genuine ROS 2, rclpy on
# rmw_zenoh, and checks the programs. Settings, all optional:
#   ROS2_KIT      folder with make-venv.sh, env.sh and overlay.tar.xz (default: foreign/ros2 beside the repository's folder)
#   ROS2_VENV     virtual environment; made if missing (default: target/foreign/ros2/venv)
#   CONSORT, CONSORT_ROS2   the programs (default: those of target/debug and sim_bridge/ros2/target/debug)
ros2=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd); root=$(cd "$ros2/../../.." && pwd)
ros2_kit=${ROS2_KIT:-$root/../shared/foreign/ros2}
export V=${ROS2_VENV:-$root/target/foreign/ros2/venv}
export CONSORT=${CONSORT:-$root/target/debug/consort} CONSORT_ROS2=${CONSORT_ROS2:-$root/sim_bridge/ros2/target/debug/consort-ros2}
[ -f "$ros2_kit/make-venv.sh" ] || skip_all "the kit with ROS 2 is absent (ROS2_KIT=$ros2_kit)"
command -v python3.11 >/dev/null || skip_all "python3.11 is absent, for which the wheels of ROS 2 are built"
command -v gcc >/dev/null && command -v g++ >/dev/null || skip_all "gcc and g++ are absent, which compile further messages"
[ -x "$CONSORT_ROS2" ] || skip_all "consort-ros2 is not built (cargo build --manifest-path sim_bridge/ros2/Cargo.toml)"
[ -x "$CONSORT" ] || skip_all "consort is not built (cargo build)"
ros2_work=$(dirname "$V"); mkdir -p "$ros2_work"
export KILTED=$ros2_work/kilted
# Packages that are no wheels; the last one has its definitions here. The mark changes with what is installed.
packages="nav2_msgs tf2_msgs rmf_door_msgs rmf_lift_msgs consort_test_msgs"
mark=$V/.consort-messages-$(cat "$ros2/environment.sh" "$ros2/make_messages.py" "$root/sim_bridge/ros2/types/jazzy.txt" | sha256sum | cut -c 1-16)
if [ ! -e "$mark" ]; then
    {
        [ -x "$V/bin/python" ] || "$ros2_kit/make-venv.sh" "$V"
        "$V/bin/pip" install -q ros-jazzy-sensor-msgs==5.3.6 ros-jazzy-nav-msgs==5.3.6 ros-jazzy-diagnostic-msgs==5.3.6 catkin_pkg
        # The messages of Kilted, for their hashes.
        [ -x "$KILTED/bin/python" ] || python3.11 -m venv "$KILTED"
        "$KILTED/bin/pip" install -q ros-kilted-rclpy==9.1.2 ros-kilted-{std-srvs,sensor-msgs,nav-msgs,diagnostic-msgs}==5.5.1
        . "$ros2_kit/env.sh"
        rm -rf "$ros2_work/messages"; cp -r "$ros2/messages" "$ros2_work/messages"
        python3 "$ros2/definitions.py" "$root/sim_bridge/ros2/types/jazzy.txt" "$ros2_work/messages" $packages
        "$V/bin/python" "$ros2/make_messages.py" "$V" "$ros2_work/messages" $packages && touch "$mark"
    } > "$ros2_work/make.log" 2>&1 || true
    [ -e "$mark" ] || { echo "fail ros2_environment: it cannot be made ($ros2_work/make.log)"; exit 1; }
fi
. "$ros2_kit/env.sh"
export ROS_PRELOAD
