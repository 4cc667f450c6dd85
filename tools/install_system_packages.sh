#!/bin/sh
# Install the Debian packages named that are missing, as root or with sudo; elsewhere say which.
set -eu

command -v dpkg-query >/dev/null 2>&1 || {
    echo "not a Debian system: make sure that the likes of these are installed: $*" >&2
    exit 0
}
missing=""
for package in "$@"; do
    status=$(dpkg-query -W -f '${Status}' "$package" 2>/dev/null || true)
    [ "$status" = "install ok installed" ] || missing="$missing $package"
done
[ -n "$missing" ] || exit 0

if [ "$(id -u)" = 0 ]; then
    as_root=""
elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    as_root="sudo"
else
    echo "missing Debian packages:$missing" >&2
    echo "ask an administrator for: apt-get install$missing" >&2
    exit 0
fi
echo "installing:$missing"
$as_root apt-get update -qq
# shellcheck disable=SC2086  # a list of words
$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing
