#!/usr/bin/env bash
# Fuzzes targets in sequence, each for the given number of seconds:
#   tests/fuzz/run.sh [SECONDS [TARGET…]]          default: 60 seconds, all targets
# It needs a nightly toolchain and cargo-fuzz (`cargo install cargo-fuzz --locked`). New inputs are
# stored in tests/fuzz/target/corpus/, failing inputs in tests/fuzz/artifacts/. The input of a fixed
# failure belongs in tests/fuzz/corpus/TARGET/. No sanitizer: Consort has no unsafe code, and a
# sanitizer requires another build of all dependencies.
set -euo pipefail
cd "$(dirname "$0")/../.."

seconds="${1:-60}"
[ $# -gt 0 ] && shift
fuzz=tests/fuzz
target="${CARGO_TARGET_DIR:-$PWD/$fuzz/target}"
if [ $# -gt 0 ]; then targets=("$@"); else targets=($(cd $fuzz/fuzz_targets && printf '%s\n' *.rs | sed 's/\.rs$//')); fi

# libFuzzer begins with the seeds of the property run.
CONSORT_FUZZ_SEEDS="$target/seeds" CONSORT_FUZZ_CASES=0 cargo test --workspace --locked --test fuzz_targets >/dev/null

CARGO_TARGET_DIR="$target" cargo +nightly fuzz build --fuzz-dir $fuzz --sanitizer none --codegen-units 16

failed=()
for name in "${targets[@]}"; do
    mkdir -p "$target/corpus/$name" "$fuzz/corpus/$name" "$target/seeds/$name" "$fuzz/artifacts/$name"
    # The time limit of the property run, and more memory than its limit.
    if nice -n 10 "$target/x86_64-unknown-linux-gnu/release/$name" -max_total_time="$seconds" -timeout=10 -rss_limit_mb=2048 \
        -max_len=65536 -print_final_stats=1 -artifact_prefix="$fuzz/artifacts/$name/" \
        "$target/corpus/$name" "$target/seeds/$name" "$fuzz/corpus/$name" >"$target/$name.log" 2>&1; then
        echo "$name: $(grep -oE 'number_of_executed_units: +[0-9]+|new_units_added: +[0-9]+' "$target/$name.log" | tr '\n' ' ')"
    else
        echo "$name: FAILED, see $target/$name.log"
        failed+=("$name")
    fi
done
rmdir --ignore-fail-on-non-empty $fuzz/corpus/* $fuzz/artifacts/* $fuzz/artifacts 2>/dev/null || true
[ ${#failed[@]} -eq 0 ]
