# What the other scripts here need of the system; sourced by them.

fail() { echo "$(basename "$0" .sh): $1" >&2; exit 1; }

as_root() {
    if [ "$(id -u)" = 0 ]; then "$@"
    elif command -v sudo >/dev/null 2>&1; then sudo "$@"
    else fail "'$*' needs root; run it yourself, then call make again."
    fi
}

# One at a time: parts of `make check` run next to each other.
debian() { as_root env DEBIAN_FRONTEND=noninteractive flock /var/lib/apt apt-get "$@"; }

install_debian() { debian install -y -qq --no-install-recommends "$@" >/dev/null; }

recent_rust() {
    cargo --version >/dev/null 2>&1 &&
        rustc --version 2>/dev/null | awk '{ split($2, v, "."); exit !(v[1] > 1 || v[2] >= 85) }'
}

# Puts a cargo on the PATH that builds the numeric core: one that is there, else Debian's.
need_cargo() {
    PATH="$PATH:$HOME/.cargo/bin"
    recent_rust && return
    command -v apt-get >/dev/null 2>&1 ||
        fail "Rust 1.85 or newer is needed to build midspan from its sources; install it, or install a wheel of midspan."
    debian update -qq
    # Debian 12 has a recent compiler under other names, Debian 13 under the usual ones.
    install_debian gcc libc6-dev cargo-web rustc-web || install_debian gcc libc6-dev cargo rustc ||
        fail "Rust could not be installed; install Rust 1.85 or newer."
    recent_rust || fail "Rust 1.85 or newer is needed; found: $(rustc --version 2>&1)."
}

# Lets a program be linked with Python's own library: the tests of the core are one.
need_libpython() {
    python=${PYTHON:-python3}
    # shellcheck disable=SC2046
    echo 'int main(void) { return 0; }' | cc -x c - -o /dev/null $("$python" -c 'import sysconfig as s
print("-L" + s.get_config_var("LIBDIR"), "-lpython" + s.get_config_var("LDVERSION"))') 2>/dev/null && return
    command -v apt-get >/dev/null 2>&1 ||
        fail "Python's library is needed by the core's tests; install it (libpython3-dev)."
    debian update -qq
    install_debian libpython3-dev
}
