#!/bin/sh
# `check`: format, lints and tests of the numeric core. `build`: compiles it and puts it into src/midspan, for a checkout
# that is used by PYTHONPATH; an installation builds it by itself.
set -eu
. tools/needs.sh
need_cargo
cd core

check() {
    if cargo fmt --version >/dev/null 2>&1; then cargo fmt --check
    else echo "core: without rustfmt here; the format is not checked." >&2
    fi
    if cargo clippy --version >/dev/null 2>&1; then cargo clippy --quiet --all-targets --no-default-features -- -D warnings
    else echo "core: without clippy here; lints are not checked." >&2
    fi
    need_libpython
    cargo test --quiet --no-default-features --lib
}

build() {
    cargo build --quiet --release
    cp "${CARGO_TARGET_DIR:-target}/release/lib_core.so" ../src/midspan/_core.abi3.so.new
    mv ../src/midspan/_core.abi3.so.new ../src/midspan/_core.abi3.so
}

case "${1:-}" in
    check | build) "$1" ;;
    *) fail "'check' or 'build' is needed; received '${1:-}'." ;;
esac
