#!/usr/bin/env bash
# Tests with Zenoh's own router, zenohd, and its REST plug-in, which are built below target/ in some minutes.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../../.." && pwd)
target=${CARGO_TARGET_DIR:-$root/target}

# Each case is a test of the workspace: its test program and its name.
cases=(
    "processes zenoh_rest::an_http_client_follows_a_mission_through_a_takeover"
    "hosts topologies::a_site_survives_a_restart_of_zenohd"
)
if [ ! -x "$target/tmp/foreign-router/zenohd" ] && ! "$here/router.sh" >&2; then
    for case in "${cases[@]}"; do echo "skip ${case#* }: zenohd cannot be built"; done
    exit 0
fi
skipped=$(mktemp)
trap 'rm -f "$skipped"' EXIT
for case in "${cases[@]}"; do
    read -r program name <<<"$case"
    : >"$skipped"
    if ! CONSORT_SKIPPED="$skipped" cargo test --quiet --locked --manifest-path "$root/Cargo.toml" --package consort \
        --test "$program" -- --exact "$name" >&2; then
        echo "fail $name: see its output above"
    elif [ -s "$skipped" ]; then
        echo "skip $name: $(cut -f 2 "$skipped" | head -n 1)"
    else
        echo "pass $name"
    fi
done
