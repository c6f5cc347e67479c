#!/usr/bin/env bash
# Checks that this crate equals the published crate with difference.patch and the added file that
# CHANGES.md names.
set -euo pipefail
cd "$(dirname "$0")"
copy="$(mktemp -d)"
trap 'rm -rf "$copy"' EXIT
cp -r Cargo.toml README.md src "$copy"
patch --quiet --reverse --directory "$copy" --strip 1 <difference.patch
rm "$copy/src/link_check.rs"
(cd "$copy" && find . -type f | LC_ALL=C sort | xargs sha256sum) | diff published.sha256 -
