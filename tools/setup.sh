#!/bin/sh
# Makes the virtual environment $VENV with midspan at the pinned versions; with the argument `dev`, also the tools of its
# checks. Needs python3 (3.11 or newer); installs Debian's venv package and Rust where they are missing.
set -eu
python=${PYTHON:-python3}
venv=${VENV:-.venv}
. tools/needs.sh

command -v "$python" >/dev/null 2>&1 || fail "'$python' was not found; install Python 3.11 or newer."
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    fail "Python 3.11 or newer is needed; '$python' is $("$python" -V 2>&1). Call make PYTHON=/path/to/python3.11."

if ! "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
    command -v apt-get >/dev/null 2>&1 || fail "Python's venv module is missing; install it (python3-venv)."
    debian update -qq
    install_debian python3-venv
fi
need_cargo

[ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
# Also the build of midspan itself takes its tools at the pinned versions.
what="${1:+[$1]}"
PIP_CONSTRAINT="$(pwd)/constraints.txt $(pwd)/constraints-dev.txt" "$venv/bin/python" -m pip install --quiet \
    --disable-pip-version-check --constraint constraints.txt --constraint constraints-dev.txt -e ".$what"
# As pip does for what it installs: a command need not compile its own sources first, wherever Python may not keep that.
"$venv/bin/python" -m compileall -q src/midspan
