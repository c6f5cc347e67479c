#!/usr/bin/env bash
# Builds the Debian package of Consort, into target/debian:
#
#     nodes/deploy/package.sh              # a release build, which takes long
#     nodes/deploy/package.sh dev          # a development build, only for inspection
#
# It needs cargo-deb (cargo install cargo-deb). [package.metadata.deb] in nodes/consort/Cargo.toml
# lists the files of the package.
set -euo pipefail
cd "$(dirname "$0")/../.."
profile=${1:-release}
target=${CARGO_TARGET_DIR:-$PWD/target}
case $profile in
    dev) folder=debug ;;
    *) folder=$profile ;;
esac
cargo build --package consort --profile "$profile" --locked

# The program writes its own manual pages and completions. The folder of `target` may vary, so the
# list in Cargo.toml refers to a fixed folder.
made=nodes/deploy/made
rm -rf "$made"
mkdir -p "$made/man"
consort=$target/$folder/consort
"$consort" man "$made/man"
gzip --best --no-name "$made"/man/*.1
gzip --best --no-name --stdout CHANGELOG.md >"$made/changelog.gz"
# Debian's changelog of the package. The changes of the program are in changelog.gz.
cat >"$made/changelog" <<END
consort ($("$consort" --version | cut -d ' ' -f 2)-1) unstable; urgency=medium

  * Changes are in changelog.gz.

 -- Consort maintainers <maintainers@consort.example>  $(date --rfc-email --utc --date "@${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct)}")
END
for shell in bash zsh fish; do
    "$consort" completions "$shell" >"$made/consort.$shell"
done
cargo deb --package consort --profile "$profile" --no-build --locked
