#!/usr/bin/env bash
# Builds Zenoh's router, zenohd, and its REST plug-in into a folder, in the version of Consort:
#
#     tests/foreign/zenoh/router.sh [FOLDER]    # default: the tests' folder
#
# A router loads a plug-in only if the same compiler has built both, with the same features of
# zenoh. So the published sources become two members of a workspace. Shared crates have the versions
# of Consort's Cargo.lock.
set -euo pipefail
checkout=$(cd "$(dirname "$0")/../../.." && pwd)
folder=${1:-${CARGO_TARGET_DIR:-$checkout/target}/tmp/foreign-router}
version=$(sed -n '/^name = "zenoh"$/{n;s/version = "\(.*\)"/\1/p;}' "$checkout/Cargo.lock")

mkdir -p "$folder/sources/fetched/src"
cd "$folder/sources"

# Cargo unpacks the fetched sources. Its warning that zenohd has no library does not matter here.
cat >fetched/Cargo.toml <<END
[package]
name = "fetched"
version = "0.0.0"
edition = "2021"
[workspace]
[dependencies]
zenohd = "=$version"
zenoh-plugin-rest = "=$version"
END
touch fetched/src/lib.rs
cargo fetch --quiet --manifest-path fetched/Cargo.toml
for crate in zenohd zenoh-plugin-rest; do
    rm -rf "$crate"
    unpacked=("${CARGO_HOME:-$HOME/.cargo}"/registry/src/*/"$crate-$version")
    cp -r "${unpacked[0]}" "$crate"
    rm -f "$crate/Cargo.lock"
done

cat >Cargo.toml <<END
[workspace]
resolver = "2"
members = ["zenohd", "zenoh-plugin-rest"]
exclude = ["fetched"]
END
cp "$checkout/Cargo.lock" .

# The build time of a router for tests matters more than its speed.
export CARGO_TARGET_DIR=$folder/sources/target CARGO_INCREMENTAL=0 CARGO_PROFILE_DEV_DEBUG=0
cargo build --package zenohd --package zenoh-plugin-rest \
    --no-default-features --features zenoh/transport_tcp,zenoh-plugin-rest/dynamic_plugin
for library in target/debug/libzenoh_plugin_rest.{so,dylib}; do
    [ ! -e "$library" ] || cp "$library" "$folder/"
done
cp target/debug/zenohd "$folder/"
rm -rf "$folder/sources"
