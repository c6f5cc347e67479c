#!/bin/bash
# Tries consort-ros2 against genuine ROS 2: rclpy on rmw_zenoh. Prints `pass NAME`, `fail NAME: why` or `skip NAME: why`
# for each case; ends with 1 if a case failed. Arguments select cases by name. Settings: environment.sh.
set -uo pipefail
here=$(cd "$(dirname "$0")" && pwd)
skip_all() { for name in $(python3 "$here/cases.py" --list); do echo "skip $name: $1"; done; exit 0; }
. "$here/environment.sh"
exec python3 "$here/cases.py" "$@"
