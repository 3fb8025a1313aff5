#!/bin/sh
# What the tests of the live site run on loopback: an MQTT broker, PostgreSQL and an RTSP server; and the browser of the
# report's tests. Debian's packages, only where they are missing; without apt-get their tests are skipped.
set -eu

. tools/needs.sh

missing=""
PATH="$PATH:/usr/sbin:/sbin"
command -v mosquitto >/dev/null 2>&1 || missing="$missing mosquitto"
ls /usr/lib/postgresql/*/bin/initdb >/dev/null 2>&1 || missing="$missing postgresql"
/usr/bin/python3 -c 'import gi; gi.require_version("GstRtspServer", "1.0")' >/dev/null 2>&1 ||
    missing="$missing python3-gi gir1.2-gstreamer-1.0 gir1.2-gst-rtsp-server-1.0"
gst-inspect-1.0 x264enc >/dev/null 2>&1 || [ -e /usr/lib/x86_64-linux-gnu/gstreamer-1.0/libgstx264.so ] ||
    missing="$missing gstreamer1.0-plugins-base gstreamer1.0-plugins-good gstreamer1.0-plugins-ugly"
command -v chromium >/dev/null 2>&1 || command -v chromium-browser >/dev/null 2>&1 ||
    command -v google-chrome >/dev/null 2>&1 || missing="$missing chromium"
[ -n "$missing" ] || exit 0
command -v apt-get >/dev/null 2>&1 || { echo "servers: no apt-get; tests with$missing are skipped." >&2; exit 0; }
# A `fail` of what needs root ends the brackets only.
# shellcheck disable=SC2086
(debian update -qq && install_debian $missing) || echo "servers: tests with$missing are skipped." >&2
