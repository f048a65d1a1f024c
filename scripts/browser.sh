#!/usr/bin/env bash
# See that there is a Chromium for the tests of the 3-D page; `make test` calls it. Safe to call again at any time.
#
# Debian has it as a package. Ubuntu's package is a snap, which tests cannot drive; there Playwright's own build is fetched.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
python=$root/.venv/bin/python

say() { printf 'browser: %s\n' "$*"; }
found() { "$python" "$root/test/helpers/browser.py" >/dev/null 2>&1; }

found && exit 0
sudo=()
if [[ $(id -u) != 0 ]]; then
  if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then sudo=(sudo -n); else sudo=(false); fi
fi
apt_install() { "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "$@" >/dev/null 2>&1; }
. /etc/os-release 2>/dev/null || ID=unknown
if [[ $ID == debian ]]; then
  say "installing chromium for the tests of the 3-D page"
  apt_install chromium || { "${sudo[@]}" apt-get update -q >/dev/null 2>&1 && apt_install chromium; } || true
else
  say "fetching a Chromium for the tests of the 3-D page"
  "$python" -m playwright install chromium >/dev/null 2>&1 || true
  found || "${sudo[@]}" "$python" -m playwright install-deps chromium >/dev/null 2>&1 || true
fi
found && exit 0
say "no Chromium could be installed, and the tests of the 3-D page will fail without one." >&2
say "Install it (Debian, as root: apt-get install chromium; elsewhere: .venv/bin/python -m playwright install --with-deps chromium)." >&2
exit 1
