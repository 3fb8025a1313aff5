# Puts a cargo on the PATH that builds the numeric core: one that is there, else Debian's. Sourced by the other scripts.
PATH="$PATH:$HOME/.cargo/bin"

recent() { [ "$("$1" --version 2>/dev/null | awk '{ split($2, v, "."); print (v[1] > 1 || v[2] >= 85) }')" = 1 ]; }

if ! { command -v cargo >/dev/null 2>&1 && recent cargo && recent rustc; }; then
    command -v apt-get >/dev/null 2>&1 || fail "Rust 1.85 or newer is needed to build midspan from its sources; install it, or install midspan as a wheel."
    as_root apt-get update
    # Debian 12 has a recent compiler under these names only, Debian 13 under the usual ones.
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends gcc libc6-dev cargo-web rustc-web ||
        as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends gcc libc6-dev cargo rustc
    recent cargo || fail "Rust 1.85 or newer is needed; cargo is $(cargo --version 2>&1)."
fi
