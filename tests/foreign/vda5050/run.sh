#!/usr/bin/env bash
# VDA 5050 with genuine software: npm vda-5050-lib and vda-5050-cli, PyPI vda5050-sdk, mosquitto. Arguments select cases by
# name. Settings: environment.sh.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
command -v python3 >/dev/null || { echo "skip vda5050: python3 is not installed"; exit 0; }
skip_all() {
    python3 "$here/cases.py" --list | sed "s|.*|skip &: $1|"
    exit 0
}
. "$here/environment.sh"
exec "$vda5050_python" "$here/cases.py" --program "$vda5050_program" --kit "$vda5050_kit" "$@"
