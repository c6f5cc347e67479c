#!/usr/bin/env bash
# VDA 5050 with genuine software: npm vda-5050-lib and vda-5050-cli, PyPI vda5050-sdk, mosquitto. The
# packages are installed below target/. CONSORT_VDA5050 names the program, instead of a build.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../../.." && pwd)
target=${CARGO_TARGET_DIR:-$root/target}
kit=${CONSORT_VDA5050_KIT:-$target/foreign/vda5050}

skip_all() {
    "$(command -v python3 || echo python)" "$here/cases.py" --list 2>/dev/null | sed "s|.*|skip &: $1|"
    exit 0
}
command -v python3 >/dev/null || { echo "skip vda5050: python3 is not installed"; exit 0; }
if ! command -v mosquitto >/dev/null && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    { apt-get update -qq && apt-get install -y -qq --no-install-recommends mosquitto openssl; } >/dev/null 2>&1 || true
fi
command -v mosquitto >/dev/null || skip_all "mosquitto is not installed"
command -v npm >/dev/null || skip_all "npm is not installed"

program=${CONSORT_VDA5050:-}
if [ -z "$program" ]; then
    cargo build --quiet --locked --manifest-path "$root/Cargo.toml" -p consort-vda5050 >&2
    program=$target/debug/consort-vda5050
fi

mkdir -p "$kit"
if [ ! -d "$kit/node_modules/vda-5050-cli" ]; then
    (cd "$kit" && npm install --silent --no-audit --no-fund --prefix . vda-5050-lib@1.4.0 vda-5050-cli@2.0.13) >/dev/null 2>&1 ||
        skip_all "npm cannot install vda-5050-lib and vda-5050-cli"
fi
if [ ! -x "$kit/venv/bin/python" ] || ! "$kit/venv/bin/python" -c 'import aiomqtt, jsonschema, vda5050' 2>/dev/null; then
    { python3 -m venv "$kit/venv" && "$kit/venv/bin/pip" install --quiet vda5050-sdk==0.2.0 aiomqtt jsonschema; } >/dev/null 2>&1 ||
        skip_all "pip cannot install vda5050-sdk"
fi
exec "$kit/venv/bin/python" "$here/cases.py" --program "$program" --kit "$kit" "$@"
