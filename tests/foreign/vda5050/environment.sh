# Sourced by a run.sh that defines `skip_all WHY`, which ends the script: installs the software of VDA 5050 below target/, and
# builds `vda5050_program`. Settings, both optional:
#   CONSORT_VDA5050       the program, instead of a build
#   CONSORT_VDA5050_KIT   folder with the packages; made if missing (default: target/foreign/vda5050)
vda5050=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd); root=$(cd "$vda5050/../../.." && pwd)
target=${CARGO_TARGET_DIR:-$root/target}
vda5050_kit=${CONSORT_VDA5050_KIT:-$target/foreign/vda5050}
vda5050_program=${CONSORT_VDA5050:-}

if ! command -v mosquitto >/dev/null && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    { apt-get update -qq && apt-get install -y -qq --no-install-recommends mosquitto openssl; } >/dev/null 2>&1 || true
fi
command -v mosquitto >/dev/null || skip_all "mosquitto is not installed"
command -v npm >/dev/null || skip_all "npm is not installed"

if [ -z "$vda5050_program" ]; then
    cargo build --quiet --locked --manifest-path "$root/Cargo.toml" -p consort-vda5050 >&2 || exit
    vda5050_program=$target/debug/consort-vda5050
fi
[ -x "$vda5050_program" ] || skip_all "$vda5050_program is not a program"

mkdir -p "$vda5050_kit"
if [ ! -d "$vda5050_kit/node_modules/vda-5050-cli" ]; then
    (cd "$vda5050_kit" && npm install --silent --no-audit --no-fund --prefix . vda-5050-lib@1.4.0 vda-5050-cli@2.0.13) >/dev/null 2>&1 ||
        skip_all "npm cannot install vda-5050-lib and vda-5050-cli"
fi
vda5050_python=$vda5050_kit/venv/bin/python
if [ ! -x "$vda5050_python" ] || ! "$vda5050_python" -c 'import aiomqtt, jsonschema, vda5050' 2>/dev/null; then
    { python3 -m venv "$vda5050_kit/venv" && "$vda5050_kit/venv/bin/pip" install --quiet vda5050-sdk==0.2.0 aiomqtt jsonschema; } >/dev/null 2>&1 ||
        skip_all "pip cannot install vda5050-sdk"
fi
