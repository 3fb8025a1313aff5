#!/bin/sh
# Looks the pinned versions up in the published advisories, with pip-audit in an environment of its own.
# Files of pins may be named; left out: both. Exit code 0: no advisory; 1: there are some, which are printed; 2: not all
# could be checked.
set -u
python=${PYTHON:-python3}
venv=${AUDIT_VENV:-.audit-venv}
report=$venv/report.json

fail() { echo "audit: $1" >&2; exit 2; }

[ -x "$venv/bin/python" ] || "$python" -m venv "$venv" || fail "the environment $venv could not be made; nothing was checked."
[ -x "$venv/bin/pip-audit" ] ||
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --timeout 15 --retries 1 pip-audit >"$venv/install.log" 2>&1 ||
    fail "pip-audit could not be installed, see $venv/install.log; nothing was checked."

[ "$#" -gt 0 ] || set -- constraints.txt constraints-dev.txt
found=0
for pins in "$@"; do
    rm -f "$report"
    "$venv/bin/pip-audit" --disable-pip --no-deps --progress-spinner off --timeout 15 --requirement "$pins" \
        --format json --output "$report" >"$venv/audit.log" 2>&1
    code=$?
    [ -s "$report" ] || fail "the advisories could not be reached, see $venv/audit.log; $pins was not checked."
    "$venv/bin/python" - "$report" "$pins" <<'END' || exit 2
import json
import sys

report, pins = sys.argv[1:]
with open(report, encoding="utf-8") as file:
    packages = json.load(file)["dependencies"]
for package in packages:
    for one in package.get("vulns", []):
        versions = ", ".join(one["fix_versions"]) or "no version yet"
        print(f"{pins}: {package['name']} {package['version']}: {one['id']}, mended in {versions}")
skipped = [package["name"] for package in packages if "skip_reason" in package]
if skipped:
    where = "the package index in use has no advisories on them"
    sys.exit(f"audit: {len(skipped)} of {len(packages)} packages of {pins} were not checked ({skipped[0]} …): {where}.")
print(f"{pins}: {len(packages)} packages checked")
END
    [ "$code" -eq 0 ] || found=1
done
exit "$found"
