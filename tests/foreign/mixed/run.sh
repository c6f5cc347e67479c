#!/usr/bin/env bash
# A fleet of three kinds does one mission: robots under genuine ROS 2, vehicles of VDA 5050 of genuine software, and simulated
# robots. Arguments select cases by name. Settings: ../ros2/environment.sh and ../vda5050/environment.sh.
set -uo pipefail
here=$(cd "$(dirname "$0")" && pwd)
command -v python3 >/dev/null || { echo "skip mixed: python3 is not installed"; exit 0; }
skip_all() {
    python3 "$here/cases.py" --list | sed "s|.*|skip &: $1|"
    exit 0
}
. "$here/../ros2/environment.sh"
. "$here/../vda5050/environment.sh"
exec "$vda5050_python" "$here/cases.py" --program "$vda5050_program" --kit "$vda5050_kit" "$@"
