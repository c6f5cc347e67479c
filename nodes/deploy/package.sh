#!/usr/bin/env bash
# Builds the Debian package of Consort, into target/debian:
#
#     nodes/deploy/package.sh              # of a release build, which takes its time
#     nodes/deploy/package.sh dev          # of what `cargo build` builds: to look at the package, not to use it
#
# It needs cargo-deb (cargo install cargo-deb). What it packs is listed in nodes/consort/Cargo.toml, [package.metadata.deb].
set -euo pipefail
cd "$(dirname "$0")/../.."
profile=${1:-release}
target=${CARGO_TARGET_DIR:-$PWD/target}
case $profile in
    dev) folder=debug ;;
    *) folder=$profile ;;
esac
# The whole workspace: a part of it alone would be built with other features, and all of Zenoh anew.
cargo build --workspace --profile "$profile" --locked

# The program writes its manual pages and completions itself. Cargo and cargo-deb know where `target` is; the list in Cargo.toml
# does not, and has them beside it.
made=nodes/deploy/made
rm -rf "$made"
mkdir -p "$made/man"
consort=$target/$folder/consort
"$consort" man "$made/man"
gzip --best --no-name "$made"/man/*.1
gzip --best --no-name --stdout CHANGELOG.md >"$made/changelog.gz"
# What Debian wants to be told of the package itself; what changed in the program is in the other one.
cat >"$made/changelog" <<END
consort ($("$consort" --version | cut -d ' ' -f 2)-1) unstable; urgency=medium

  * Changes are in changelog.gz.

 -- Consort maintainers <maintainers@consort.example>  $(date --rfc-email --utc --date "@${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct)}")
END
for shell in bash zsh fish; do
    "$consort" completions "$shell" >"$made/consort.$shell"
done
cargo deb --package consort --profile "$profile" --no-build --locked
