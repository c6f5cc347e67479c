#!/usr/bin/env bash
# Runs every test with foreign software: tests/foreign/*/run.sh. Each of these prints a line per case:
#
#     pass NAME
#     fail NAME: why
#     skip NAME: why
#
# The last line is `N passed, N failed, N skipped`; the status is 1 if a case failed. A folder as an
# argument runs its cases only: tests/foreign/run.sh vda5050
set -uo pipefail
cd "$(dirname "$0")"

output=$(mktemp)
trap 'rm -f "$output"' EXIT
for script in ${1:-*}/run.sh; do
    name=$(dirname "$script")
    printf '== %s\n' "$name"
    "./$script" 2>&1 | tee -a "$output"
    status=${PIPESTATUS[0]}
    # A script that ends early must not look like one without cases.
    [ "$status" = 0 ] || grep -q '^fail ' "$output" || echo "fail $name: run.sh ended with status $status" | tee -a "$output"
done
count() { grep -c "^$1 " "$output"; }
failed=$(count fail)
echo "$(count pass) passed, $failed failed, $(count skip) skipped"
[ "$failed" = 0 ]
